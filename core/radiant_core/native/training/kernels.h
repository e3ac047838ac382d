// What the kernels of training work on, and their table. Plain data: training/kernels.cpp is
// compiled per instruction set and includes no standard header's templates.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace radiant {

// One image of H x W pixels against its target; float arrays (H,W,3) unless said otherwise.
struct LossJob {
  const float* image;
  const float* target;
  const float* means;      // blur(target)
  const float* variances;  // blur(target^2) - blur(target)^2
  const float* weights;    // (H,W), or null for ones
  float* gradient;         // or null: the value alone
  double* row_sums;        // (H,2): sum of the weighted errors of a row; sum of |image - target|
  int64_t height, width;
  float ssim_weight;       // lambda
  float pixel_share;       // 1 / (3 sum of weights)
};

struct StatisticsJob {
  const float* target;
  float* means;
  float* variances;
  int64_t height, width;
};

// Consecutive visible rows that have been updated equally often.
struct Run {
  int32_t begin, end;
};

// Adam over N rows of `columns` floats.
struct AdamJob {
  float* parameters;
  const float* gradients;
  float* first_moments;
  float* second_moments;
  const Run* runs;              // the rows to update, ascending; null for all rows
  const int32_t* steps;         // (N) how often each row was updated, with this; null where runs is
  const float* first_factors;   // (T) 1 / (1 - beta1^t)
  const float* second_factors;  // (T) 1 / sqrt(1 - beta2^t)
  int64_t num_factors;          // T: later steps take the last factor
  int64_t step;                 // of all rows, where `runs` is null
  int64_t columns;
  float rate, beta2, epsilon;
  float first_share, second_share;  // 1 - beta1, 1 - beta2 in double: 1 - 0.999f is 1.3e-5 off
};

struct Found {
  int64_t count, first;  // first: flat index
};

struct TrainingKernels {
  const char* name;
  // Floats of scratch memory that one thread needs for images of this width.
  size_t (*loss_scratch)(int64_t width);
  // Rows begin to end of the gradient and of the row sums.
  void (*loss_rows)(const LossJob& job, int64_t begin, int64_t end, float* scratch);
  void (*statistics_rows)(const StatisticsJob& job, int64_t begin, int64_t end, float* scratch);
  // Runs begin to end, or rows begin to end where there are no runs.
  void (*adam_rows)(const AdamJob& job, int64_t begin, int64_t end);
  // Values that are NaN or larger in size than `largest`.
  Found (*rows_beyond)(const float* values, const Run* runs, int64_t columns, int64_t begin, int64_t end, float largest);
};

}  // namespace radiant
