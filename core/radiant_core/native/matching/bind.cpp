// Checks every array, lets go of the interpreter lock, calls the kernels.
#include "matching/bind.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "machine/instruction_sets.h"
#include "matching/kernels.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace radiant {

namespace portable { extern const MatchingKernels matching_kernels; }
#ifdef RADIANT_X86
namespace avx2 { extern const MatchingKernels matching_kernels; }
namespace avx512 { extern const MatchingKernels matching_kernels; }
namespace avx512vnni { extern const MatchingKernels matching_kernels; }
#endif

namespace {

// The build of that name, the fastest for an empty name, null for one that this CPU cannot run.
const MatchingKernels* find_matching_kernels(const std::string& name) {
#ifdef RADIANT_X86
  return find_build({&avx512vnni::matching_kernels, &avx512::matching_kernels, &avx2::matching_kernels, &portable::matching_kernels}, name);
#else
  return find_build({&portable::matching_kernels}, name);
#endif
}

}  // namespace
}  // namespace radiant

namespace {

using Descriptors = nb::ndarray<const std::uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Numbers = nb::ndarray<nb::numpy, std::int32_t, nb::ndim<1>>;

constexpr std::size_t kMaxDescriptors = std::size_t{1} << 24;

[[noreturn]] void raise(const std::string& message) { throw nb::value_error(message.c_str()); }

void check(const Descriptors& array, const std::string& name) {
  if (array.shape(1) != radiant::kDescriptorBytes || array.shape(0) == 0 || array.shape(0) >= kMaxDescriptors)
    raise(name + " has shape (" + std::to_string(array.shape(0)) + ", " + std::to_string(array.shape(1)) +
          "), expected (N, 128) with N from 1 to 2^24");
}

Numbers to_numpy(std::unique_ptr<std::int32_t[]> values, std::size_t count) {
  std::int32_t* data = values.release();
  nb::capsule owner(data, [](void* pointer) noexcept { delete[] static_cast<std::int32_t*>(pointer); });
  return Numbers(data, {count}, owner);
}

std::tuple<Numbers, Numbers, Numbers, Numbers> compare_descriptors(const Descriptors& first, const Descriptors& second,
                                                                   const std::string& instruction_set) {
  const radiant::MatchingKernels* kernels = radiant::find_matching_kernels(instruction_set);
  if (!kernels) raise("instruction_set '" + instruction_set + "' is unknown or not this CPU's: avx512vnni, avx512, avx2 or portable");
  check(first, "first");
  check(second, "second");
  const std::size_t count = first.shape(0), groups = (second.shape(0) + radiant::kGroup - 1) / radiant::kGroup;
  auto best = std::make_unique<std::int32_t[]>(count), next = std::make_unique<std::int32_t[]>(count), index = std::make_unique<std::int32_t[]>(count);
  auto column_best = std::make_unique<std::int32_t[]>(groups * radiant::kGroup);
  {
    const nb::gil_scoped_release unlocked;
    std::vector<std::uint8_t> packed(groups * static_cast<std::size_t>(kernels->bytes_per_group));
    kernels->pack(second.data(), static_cast<std::int64_t>(second.shape(0)), static_cast<std::int64_t>(groups), packed.data());
    kernels->compare({first.data(), static_cast<std::int64_t>(count), packed.data(), static_cast<std::int64_t>(groups), best.get(), next.get(),
                      index.get(), column_best.get()});
  }
  return {to_numpy(std::move(index), count), to_numpy(std::move(best), count), to_numpy(std::move(next), count),
          to_numpy(std::move(column_best), second.shape(0))};
}

}  // namespace

void bind_matching(nb::module_& module) {
  module.def("compare_descriptors", &compare_descriptors, "first"_a, "second"_a, "instruction_set"_a = "",
             "Products of descriptors: for each of first (N,128) uint8 the index (N,) of the one of second (M,128) uint8 with which its product\n"
             "is greatest (the smallest of equal ones), that product (N,) and the next greatest (N,), 0 where there is none; and for each of\n"
             "second the greatest product (M,); all int32 and exact. Raises ValueError for another shape, and for an instruction set (avx512vnni,\n"
             "avx512, avx2, portable; empty: the fastest) that this CPU does not have.");
}
