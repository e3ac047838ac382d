#include "training_isa.h"

#include <algorithm>

#include "thread_pool.h"

namespace radiant {

namespace training::portable { extern const TrainingKernels kernels; }
#ifdef RADIANT_X86
namespace training::avx2 { extern const TrainingKernels kernels; }
namespace training::avx512 { extern const TrainingKernels kernels; }
#endif

const std::vector<const TrainingKernels*>& training_kernels() {
  static const std::vector<const TrainingKernels*> usable = [] {
    std::vector<const TrainingKernels*> found;
#ifdef RADIANT_X86
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw"))
      found.push_back(&training::avx512::kernels);
    if (avx2) found.push_back(&training::avx2::kernels);
#endif
    found.push_back(&training::portable::kernels);
    return found;
  }();
  return usable;
}

const TrainingKernels* training_kernels(const std::string& name) {
  for (const TrainingKernels* kernels : training_kernels()) {
    if (name.empty() || name == kernels->name) return kernels;
  }
  return nullptr;
}

void share_rows(int num_threads, std::int64_t num_rows, std::int64_t min_rows, const std::function<void(std::int64_t, std::int64_t)>& work) {
  const std::int64_t parts = std::clamp<std::int64_t>(num_rows / std::max<std::int64_t>(min_rows, 1), 1, std::max(num_threads, 1));
  parallel_for(num_threads, parts, [&](std::int64_t part, int) { work(num_rows * part / parts, num_rows * (part + 1) / parts); });
}

}  // namespace radiant
