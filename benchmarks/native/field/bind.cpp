// Checks every array, lets go of the interpreter lock, deals levels or places to threads.

#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>

#include <cmath>
#include <cstdint>
#include <string>

#include "field/kernels.h"
#include "machine/instruction_sets.h"
#include "machine/thread_pool.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace radiant::field {

namespace portable { extern const FieldKernels kernels; }
#ifdef RADIANT_X86
namespace avx2 { extern const FieldKernels kernels; }
namespace avx512 { extern const FieldKernels kernels; }
#endif

}  // namespace radiant::field

namespace {

using In = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Out = nb::ndarray<float, nb::c_contig, nb::device::cpu>;
using Sides = nb::ndarray<const std::int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// One thread's share is worth waking it for.
constexpr std::int64_t kPlacesAPart = 4096;

[[noreturn]] void raise(const std::string& message) { throw nb::value_error(message.c_str()); }

const radiant::FieldKernels& kernels_named(const std::string& name) {
#ifdef RADIANT_X86
  const auto* found =
      radiant::find_build({&radiant::field::avx512::kernels, &radiant::field::avx2::kernels, &radiant::field::portable::kernels}, name);
#else
  const auto* found = radiant::find_build({&radiant::field::portable::kernels}, name);
#endif
  if (!found) raise("instruction_set '" + name + "' is unknown or not this CPU's: see instruction_sets()");
  return *found;
}

template <class Array>
void check_shape(const Array& array, const std::string& name, std::initializer_list<std::size_t> expected) {
  bool fits = array.ndim() == expected.size();
  std::size_t axis = 0;
  for (const std::size_t want : expected) fits = fits && array.shape(axis++) == want;
  if (!fits) raise(name + " has another shape than its grid and places need");
}

radiant::GridJob job_of(const In& places, const In& table, const Sides& resolutions) {
  if (places.ndim() != 2 || places.shape(0) != 3) raise("places has another shape than (3, N)");
  const std::size_t levels = resolutions.shape(0);
  if (table.ndim() != 3 || table.shape(0) != levels || table.shape(2) != 2) raise("table has another shape than (L, T, 2)");
  const std::size_t entries = table.shape(1);
  if (entries == 0 || (entries & (entries - 1)) || entries > (std::size_t{1} << 30)) raise("table has " + std::to_string(entries) + " entries a level, expected a power of two");
  for (std::size_t level = 0; level < levels; ++level) {
    const std::int32_t side = resolutions.data()[level];
    if (side < 1 || side > 65535) raise("resolutions has " + std::to_string(side) + " at index " + std::to_string(level) + ", expected 1 to 65535");
  }
  for (std::size_t i = 0; i < places.size(); ++i)
    if (!std::isfinite(places.data()[i])) raise("places has a number that is not finite at index " + std::to_string(i));
  radiant::GridJob job{};
  job.places = places.data(), job.table = table.data(), job.resolutions = resolutions.data();
  job.count = static_cast<std::int64_t>(places.shape(1));
  job.levels = static_cast<std::int64_t>(levels), job.entries = static_cast<std::int64_t>(entries);
  return job;
}

void encode(const In& places, const In& table, const Sides& resolutions, const Out& features, int num_threads, const std::string& instruction_set) {
  radiant::GridJob job = job_of(places, table, resolutions);
  check_shape(features, "features", {2 * resolutions.shape(0), places.shape(1)});
  job.features = features.data();
  const radiant::FieldKernels& kernels = kernels_named(instruction_set);
  const nb::gil_scoped_release unlocked;
  radiant::parallel_for(num_threads, job.levels, [&](std::int64_t level, int) { kernels.encode_level(job, level); });
}

void gradients(const In& places, const In& table, const Sides& resolutions, const In& feature_gradients, const Out& table_gradients,
               const Out& place_gradients, int num_threads, const std::string& instruction_set) {
  radiant::GridJob job = job_of(places, table, resolutions);
  check_shape(feature_gradients, "feature_gradients", {2 * resolutions.shape(0), places.shape(1)});
  if (table_gradients.size()) check_shape(table_gradients, "table_gradients", {table.shape(0), table.shape(1), 2});
  if (place_gradients.size()) check_shape(place_gradients, "place_gradients", {3, places.shape(1)});
  job.feature_gradients = feature_gradients.data();
  job.table_gradients = table_gradients.data(), job.place_gradients = place_gradients.data();
  const radiant::FieldKernels& kernels = kernels_named(instruction_set);
  const bool of_table = table_gradients.size() > 0, of_places = place_gradients.size() > 0;
  const nb::gil_scoped_release unlocked;
  if (of_table) radiant::parallel_for(num_threads, job.levels, [&](std::int64_t level, int) { kernels.table_gradient_level(job, level); });
  const std::int64_t parts = (job.count + kPlacesAPart - 1) / kPlacesAPart;
  if (of_places) {
    radiant::parallel_for(num_threads, parts, [&](std::int64_t part, int) {
      const std::int64_t begin = part * kPlacesAPart, end = begin + kPlacesAPart < job.count ? begin + kPlacesAPart : job.count;
      kernels.place_gradients(job, begin, end);
    });
  }
}

}  // namespace

NB_MODULE(_radiant_fields, module) {
  module.doc() = "The hash grid of radiance fields; its plain twin is torch's, in benchmarks/fields/hash_grid.py.";
  module.def("encode_places", &encode, "places"_a, "table"_a, "resolutions"_a, "features"_a.noconvert(), "num_threads"_a = 1, "instruction_set"_a = "",
             "Writes the features (2L,N) of places (3,N) in 0..1 from a hash grid's table (L,T,2); resolutions (L) int32: cells a side.\n\n"
             "The same bits for any number of threads. Raises ValueError naming the array for a wrong shape and for places not finite.");
  module.def("grid_gradients", &gradients, "places"_a, "table"_a, "resolutions"_a, "feature_gradients"_a, "table_gradients"_a.noconvert(),
             "place_gradients"_a.noconvert(), "num_threads"_a = 1, "instruction_set"_a = "",
             "Adds to table_gradients (L,T,2) and writes place_gradients (3,N), either left out where it is empty.\n\n"
             "Where the places are on a border between cells, the slope is that of the upper cell. Raises as encode_places.");
}
