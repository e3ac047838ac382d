#include "adam.h"

#include <algorithm>
#include <mutex>

#include "training_isa.h"

namespace radiant {
namespace {

// Starting a thread takes as long as some ten thousand floats.
std::int64_t min_rows(std::int64_t columns) { return std::max<std::int64_t>(1, (1 << 15) / std::max<std::int64_t>(columns, 1)); }

}  // namespace

std::vector<Run> visible_runs(const bool* visible, const std::int32_t* steps, std::size_t num_rows) {
  std::vector<Run> runs;
  for (std::size_t row = 0; row < num_rows; ++row) {
    if (!visible[row]) continue;
    const std::int32_t at = static_cast<std::int32_t>(row);
    if (!runs.empty() && runs.back().end == at && steps[runs.back().begin] == steps[row]) {
      runs.back().end = at + 1;
    } else {
      runs.push_back({at, at + 1});
    }
  }
  return runs;
}

void adam_step(const AdamJob& job, std::int64_t num_rows, std::int64_t num_runs, const TrainingKernels& kernels, int num_threads) {
  share_rows(num_threads, job.runs ? num_runs : num_rows, min_rows(job.columns),
             [&](std::int64_t begin, std::int64_t end) { kernels.adam_rows(job, begin, end); });
}

NotFinite find_not_finite(const float* values, const Run* runs, std::int64_t count, std::int64_t columns, const TrainingKernels& kernels,
                          int num_threads) {
  NotFinite total{0, -1};
  std::mutex adding;
  share_rows(num_threads, count, min_rows(columns), [&](std::int64_t begin, std::int64_t end) {
    const NotFinite found = kernels.not_finite_rows(values, runs, columns, begin, end);
    const std::lock_guard<std::mutex> lock(adding);
    total.count += found.count;
    if (found.first >= 0 && (total.first < 0 || found.first < total.first)) total.first = found.first;
  });
  return total;
}

}  // namespace radiant
