// Which build of the training kernels runs, and the threads that share its rows.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "training/kernels.h"

namespace radiant {

// The build of that name, the fastest for an empty name, null for one that this CPU cannot run.
const TrainingKernels* find_training_kernels(const std::string& name);

// Calls `work(begin, end)` for up to `num_threads` ranges of `num_rows` rows, each >= `min_rows`.
void share_rows(int num_threads, std::int64_t num_rows, std::int64_t min_rows, const std::function<void(std::int64_t, std::int64_t)>& work);

}  // namespace radiant
