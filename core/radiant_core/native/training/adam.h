// Adam over the rows of one tensor, all of them or the visible ones.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "training/kernels.h"

namespace radiant {

// The visible of N rows as ascending runs of equal `steps` (N), at most 1,024 rows; once per step.
std::vector<Run> visible_runs(const bool* visible, const std::int32_t* steps, std::size_t num_rows);

// One step of `job` on its runs, or all `num_rows` rows; the same bits for any number of threads.
void adam_step(const AdamJob& job, std::int64_t num_rows, std::int64_t num_runs, const TrainingKernels& kernels, int num_threads);

// How many of `values` (N, columns) in the rows of `runs`, or all for null, are NaN or larger in
// size than `largest`, the flat index of the first; {0, -1} for none. `count`: of runs or rows.
Found find_beyond(const float* values, const Run* runs, std::int64_t count, std::int64_t columns, float largest, const TrainingKernels& kernels,
                  int num_threads);

}  // namespace radiant
