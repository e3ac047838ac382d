// Kernels are built per instruction set from one source; the build is chosen by name or CPU.
#pragma once

#include <initializer_list>
#include <string>

namespace radiant {

// Whether this CPU runs the build of that name: avx512, avx2 or portable.
bool cpu_runs(const std::string& name);

// Of `builds`, fastest first: that of the name, the first that runs for an empty name, else null.
template <class Kernels>
const Kernels* find_build(std::initializer_list<const Kernels*> builds, const std::string& name) {
  for (const Kernels* build : builds)
    if ((name.empty() || name == build->name) && cpu_runs(build->name)) return build;
  return nullptr;
}

}  // namespace radiant
