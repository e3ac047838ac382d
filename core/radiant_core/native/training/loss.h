// The training loss (1 - lambda) L1 + lambda (1 - SSIM), its gradient, the target's statistics.
#pragma once

#include "training/kernels.h"

namespace radiant {

struct LossSums {
  double loss;      // weighted by shares of the pixels, the shares adding up to 1, or all 0
  double distance;  // sum of |image - target|: not finite where a value of either is not
  bool negative_weight;
};

// Runs `job` on `num_threads` threads, with the same bits; sets its `row_sums` and `pixel_share`.
LossSums training_loss(LossJob job, const TrainingKernels& kernels, int num_threads);

// Blurred mean and variance of a target, rounded once from double.
void target_statistics(const StatisticsJob& job, const TrainingKernels& kernels, int num_threads);

}  // namespace radiant
