// Kernels are built once per instruction set from one source; which build runs is chosen by name or
// by what the CPU can do.
#pragma once

#include <initializer_list>
#include <string>

namespace radiant {

// Whether this CPU runs the build of that name: avx512vnni, avx512, avx2 or portable.
bool cpu_runs(const std::string& name);

// Of `builds`, the fastest first: the one of that name, for an empty name the first that runs here,
// null where there is none.
template <class Kernels>
const Kernels* find_build(std::initializer_list<const Kernels*> builds, const std::string& name) {
  for (const Kernels* build : builds)
    if ((name.empty() || name == build->name) && cpu_runs(build->name)) return build;
  return nullptr;
}

}  // namespace radiant
