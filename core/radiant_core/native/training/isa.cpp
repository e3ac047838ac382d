#include "training/isa.h"

#include <algorithm>

#include "machine/instruction_sets.h"
#include "machine/thread_pool.h"

namespace radiant {

namespace training::portable { extern const TrainingKernels kernels; }
#ifdef RADIANT_X86
namespace training::avx2 { extern const TrainingKernels kernels; }
namespace training::avx512 { extern const TrainingKernels kernels; }
#endif

const TrainingKernels* find_training_kernels(const std::string& name) {
#ifdef RADIANT_X86
  return find_build({&training::avx512::kernels, &training::avx2::kernels, &training::portable::kernels}, name);
#else
  return find_build({&training::portable::kernels}, name);
#endif
}

void share_rows(int num_threads, std::int64_t num_rows, std::int64_t min_rows, const std::function<void(std::int64_t, std::int64_t)>& work) {
  const std::int64_t parts = std::clamp<std::int64_t>(num_rows / std::max<std::int64_t>(min_rows, 1), 1, std::max(num_threads, 1));
  parallel_for(num_threads, parts, [&](std::int64_t part, int) { work(num_rows * part / parts, num_rows * (part + 1) / parts); });
}

}  // namespace radiant
