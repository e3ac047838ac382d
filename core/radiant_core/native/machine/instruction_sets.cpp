#include "machine/instruction_sets.h"

#if defined(RADIANT_X86)
#include <cpuid.h>
#endif

namespace radiant {

#if defined(RADIANT_X86)
namespace {

// Asked of the CPU itself: zig 0.17 answers every __builtin_cpu_supports with no.
struct Registers {
  unsigned a = 0, b = 0, c = 0, d = 0;
};

Registers cpuid(unsigned leaf) {
  Registers r;
  // Zeros where the CPU has no such leaf.
  __get_cpuid_count(leaf, 0, &r.a, &r.b, &r.c, &r.d);
  return r;
}

bool has(unsigned bits, std::initializer_list<int> places) {
  for (const int place : places) {
    if (!(bits >> place & 1)) return false;
  }
  return true;
}

// What the operating system keeps of the registers when it changes threads.
unsigned kept_registers() {
  unsigned low, high;
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return low;
}

}  // namespace
#endif

bool cpu_runs(const std::string& name) {
#if defined(RADIANT_X86)
  // What -march=x86-64-v3 and -v4 let the compiler use; bits from Intel's manual, volume 2A, CPUID.
  const Registers first = cpuid(1), seventh = cpuid(7);
  const unsigned kept = has(first.c, {27}) ? kept_registers() : 0;  // osxsave
  // fma avx; bmi avx2 bmi2
  const bool avx2 = has(kept, {1, 2}) && has(first.c, {12, 28}) && has(seventh.b, {3, 5, 8});
  if (name == "avx2") return avx2;
  // f dq cd bw vl
  const bool avx512 = avx2 && has(kept, {5, 6, 7}) && has(seventh.b, {16, 17, 28, 30, 31});
  if (name == "avx512") return avx512;
  if (name == "avx512vnni") return avx512 && has(seventh.c, {11});
#endif
  return name == "portable";
}

}  // namespace radiant
