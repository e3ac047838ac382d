#include "training/adam.h"

#include <algorithm>
#include <mutex>

#include "machine/thread_pool.h"

namespace radiant {
namespace {

// Along a curve through space what is visible lies in few, long runs; cut, they share evenly.
constexpr std::int32_t kMaxRun = 1024;

// Calls work(begin, end) for ranges of runs, or of rows where `runs` is null, of about equal rows.
template <class Work>
void share_runs(int num_threads, const Run* runs, std::int64_t count, std::int64_t columns, const Work& work) {
  if (count == 0) return;
  const std::int64_t num_rows = runs ? runs[count - 1].end : count;
  // Sharing takes as long as some ten thousand floats.
  const std::int64_t parts = std::clamp<std::int64_t>(num_rows * columns >> 15, 1, 4 * num_threads);
  const auto border = [&](std::int64_t part) {
    const std::int64_t row = num_rows * part / parts;
    return runs ? std::lower_bound(runs, runs + count, row, [](const Run& run, std::int64_t at) { return run.begin < at; }) - runs : row;
  };
  parallel_for(num_threads, parts, [&](std::int64_t part, int) { work(border(part), border(part + 1)); });
}

}  // namespace

std::vector<Run> visible_runs(const bool* visible, const std::int32_t* steps, std::size_t num_rows) {
  std::vector<Run> runs;
  for (std::size_t row = 0; row < num_rows; ++row) {
    if (!visible[row]) continue;
    const std::int32_t at = static_cast<std::int32_t>(row);
    if (!runs.empty() && runs.back().end == at && at % kMaxRun && steps[runs.back().begin] == steps[row]) {
      runs.back().end = at + 1;
    } else {
      runs.push_back({at, at + 1});
    }
  }
  return runs;
}

void adam_step(const AdamJob& job, std::int64_t num_rows, std::int64_t num_runs, const TrainingKernels& kernels, int num_threads) {
  share_runs(num_threads, job.runs, job.runs ? num_runs : num_rows, job.columns,
             [&](std::int64_t begin, std::int64_t end) { kernels.adam_rows(job, begin, end); });
}

Found find_beyond(const float* values, const Run* runs, std::int64_t count, std::int64_t columns, float largest, const TrainingKernels& kernels,
                  int num_threads) {
  Found total{0, -1};
  std::mutex adding;
  share_runs(num_threads, runs, count, columns, [&](std::int64_t begin, std::int64_t end) {
    const Found found = kernels.rows_beyond(values, runs, columns, begin, end, largest);
    const std::lock_guard<std::mutex> lock(adding);
    total.count += found.count;
    if (found.first >= 0 && (total.first < 0 || found.first < total.first)) total.first = found.first;
  });
  return total;
}

}  // namespace radiant
