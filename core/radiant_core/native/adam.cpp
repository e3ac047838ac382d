#include "adam.h"

#include <algorithm>
#include <mutex>

#include "training_isa.h"

namespace radiant {
namespace {

// Starting a thread takes as long as some ten thousand floats.
std::int64_t min_rows(std::int64_t columns) { return std::max<std::int64_t>(1, (1 << 15) / std::max<std::int64_t>(columns, 1)); }

}  // namespace

void adam_step(const AdamJob& job, std::int64_t num_rows, const TrainingKernels& kernels, int num_threads) {
  share_rows(num_threads, num_rows, min_rows(job.columns), [&](std::int64_t begin, std::int64_t end) { kernels.adam_rows(job, begin, end); });
}

NotFinite find_not_finite(const float* values, const bool* visible, std::int64_t num_rows, std::int64_t columns,
                          const TrainingKernels& kernels, int num_threads) {
  NotFinite total{0, -1};
  std::mutex adding;
  share_rows(num_threads, num_rows, min_rows(columns), [&](std::int64_t begin, std::int64_t end) {
    const NotFinite found = kernels.not_finite_rows(values, visible, columns, begin, end);
    const std::lock_guard<std::mutex> lock(adding);
    total.count += found.count;
    if (found.first >= 0 && (total.first < 0 || found.first < total.first)) total.first = found.first;
  });
  return total;
}

}  // namespace radiant
