#include "machine/instruction_sets.h"

namespace radiant {

bool cpu_runs(const std::string& name) {
#if defined(RADIANT_X86)
  // What -march=x86-64-v3 and -v4 let the compiler use.
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
  if (name == "avx2") return avx2;
  const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
                      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512cd");
  if (name == "avx512") return avx512;
  if (name == "avx512vnni") return avx512 && __builtin_cpu_supports("avx512vnni");
#endif
  return name == "portable";
}

}  // namespace radiant
