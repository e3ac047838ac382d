// Rows are dealt to threads; sums are added in the image's order. Once per step.
#include "training/loss.h"

#include <algorithm>
#include <memory>
#include <new>
#include <vector>

#include "training/isa.h"

namespace radiant {
namespace {

// A thread derives ten rows beyond its own: below this many rows it costs more than it saves.
constexpr std::int64_t kMinRows = 32;

struct AlignedDelete {
  void operator()(float* memory) const { ::operator delete[](memory, std::align_val_t(64)); }
};

std::unique_ptr<float[], AlignedDelete> aligned_floats(std::size_t count) {
  return std::unique_ptr<float[], AlignedDelete>(new (std::align_val_t(64)) float[count]);
}

double sum_of_weights(const LossJob& job, bool& negative) {
  if (!job.weights) return static_cast<double>(job.height) * static_cast<double>(job.width);
  double sum = 0;
  for (std::int64_t i = 0; i < job.height * job.width; ++i) {
    sum += job.weights[i];
    negative |= job.weights[i] < 0;
  }
  return std::max(sum, 1e-6);
}

}  // namespace

LossSums training_loss(LossJob job, const TrainingKernels& kernels, int num_threads) {
  std::vector<double> row_sums(2 * job.height);
  job.row_sums = row_sums.data();
  LossSums sums{0, 0, false};
  job.pixel_share = static_cast<float>(1 / (3 * sum_of_weights(job, sums.negative_weight)));
  share_rows(num_threads, job.height, kMinRows, [&](std::int64_t begin, std::int64_t end) {
    kernels.loss_rows(job, begin, end, aligned_floats(kernels.loss_scratch(job.width)).get());
  });
  for (std::int64_t y = 0; y < job.height; ++y) {
    sums.loss += row_sums[2 * y];
    sums.distance += row_sums[2 * y + 1];
  }
  return sums;
}

void target_statistics(const StatisticsJob& job, const TrainingKernels& kernels, int num_threads) {
  share_rows(num_threads, job.height, kMinRows, [&](std::int64_t begin, std::int64_t end) {
    kernels.statistics_rows(job, begin, end, aligned_floats(kernels.loss_scratch(job.width)).get());
  });
}

}  // namespace radiant
