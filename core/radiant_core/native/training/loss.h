// The training loss (1 - lambda) L1 + lambda (1 - SSIM) of one image against one target, its
// gradient, and the target's statistics.
#pragma once

#include "training/kernels.h"

namespace radiant {

struct LossSums {
  double loss;      // weighted by shares of the pixels, the shares adding up to 1, or all 0
  double distance;  // sum of |image - target|: not finite where a value of either is not
  bool negative_weight;
};

// Runs `job` on at most `num_threads` threads; the same bits for any number. `row_sums` and
// `pixel_share` of the job are set here.
LossSums training_loss(LossJob job, const TrainingKernels& kernels, int num_threads);

// Blurred mean and variance of a target, rounded once from double.
void target_statistics(const StatisticsJob& job, const TrainingKernels& kernels, int num_threads);

}  // namespace radiant
