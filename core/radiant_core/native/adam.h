// Adam over the rows of one tensor, all of them or the visible ones.
#pragma once

#include <cstdint>

#include "training_kernels.h"

namespace radiant {

// One step of `job` on N rows; rows are independent, so any number of threads gives the same bits.
void adam_step(const AdamJob& job, std::int64_t num_rows, const TrainingKernels& kernels, int num_threads);

// How many of `values` (N, columns) in visible rows are NaN or infinite, and the flat index of the first; {0, -1} for none.
NotFinite find_not_finite(const float* values, const bool* visible, std::int64_t num_rows, std::int64_t columns,
                          const TrainingKernels& kernels, int num_threads);

}  // namespace radiant
