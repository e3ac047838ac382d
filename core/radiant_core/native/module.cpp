// The Python border of the native kernels: checks arrays, releases the interpreter lock, and calls.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "dense/bind.h"
#include "matching/bind.h"
#include "plan/bind.h"
#include "plan/power_cells.h"
#include "raster/bind.h"
#include "training/bind.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

using Array = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Cells = nb::ndarray<nb::numpy, std::int32_t, nb::ndim<1>>;

constexpr std::size_t kAny = std::numeric_limits<std::size_t>::max();

[[noreturn]] void raise(const std::string& message) { throw nb::value_error(message.c_str()); }

std::string listed(const std::vector<std::size_t>& numbers) {
  std::string text = "(";
  for (std::size_t i = 0; i < numbers.size(); ++i) text += (i ? ", " : "") + std::to_string(numbers[i]);
  return text + (numbers.size() == 1 ? ",)" : ")");
}

std::vector<std::size_t> shape_of(const Array& array) {
  return {array.shape_ptr(), array.shape_ptr() + array.ndim()};
}

// `expected` may hold kAny, which `letters` then names in the message.
void check_shape(const Array& array, const std::string& name, const std::vector<std::size_t>& expected, const std::string& letters) {
  const auto shape = shape_of(array);
  bool fits = shape.size() == expected.size();
  for (std::size_t i = 0; fits && i < shape.size(); ++i) fits = expected[i] == kAny || expected[i] == shape[i];
  if (!fits) raise(name + " has shape " + listed(shape) + ", expected " + letters);
}

// The index along each axis of the element at `flat` in row-major order.
std::vector<std::size_t> unravelled(std::size_t flat, const std::vector<std::size_t>& shape) {
  std::vector<std::size_t> index(shape.size());
  for (std::size_t axis = shape.size(); axis-- > 0; flat /= shape[axis]) index[axis] = flat % shape[axis];
  return index;
}

void check_finite(const Array& array, const std::string& name) {
  std::size_t count = 0, first = 0;
  for (std::size_t i = 0; i < array.size(); ++i) {
    if (std::isfinite(array.data()[i])) continue;
    if (count++ == 0) first = i;
  }
  if (count == 0) return;
  raise(name + " holds " + std::to_string(count) + (count == 1 ? " value that is" : " values that are") +
        " not finite, the first at index " + listed(unravelled(first, shape_of(array))));
}

Cells assign_power_cells(const Array& positions, const Array& sites, const Array& weights) {
  check_shape(positions, "positions", {kAny, 2}, "(C, 2)");
  check_shape(sites, "sites", {kAny, 2}, "(E, 2)");
  const std::size_t num_positions = positions.shape(0), num_sites = sites.shape(0);
  check_shape(weights, "weights", {num_sites}, "(" + std::to_string(num_sites) + ",), one per site");
  if (num_sites == 0) raise("sites has shape (0, 2), expected at least one site");
  check_finite(positions, "positions");
  check_finite(sites, "sites");
  check_finite(weights, "weights");

  auto cells = std::make_unique<std::int32_t[]>(num_positions);
  std::size_t done = 0;
  {
    nb::gil_scoped_release unlocked;
    done = radiant::assign_power_cells(positions.data(), num_positions, sites.data(), weights.data(), num_sites, cells.get());
  }
  if (done != num_positions) raise("positions is too far from every site at index " + listed({done}) + ": the squared distance overflows");
  std::int32_t* data = cells.release();
  nb::capsule owner(data, [](void* pointer) noexcept { delete[] static_cast<std::int32_t*>(pointer); });
  return Cells(data, {num_positions}, owner);
}

}  // namespace

NB_MODULE(_native, module) {
  module.doc() = "Kernels in C++ that numpy or torch would be too slow for; each has a plain twin in the tests.";
  module.def("assign_power_cells", &assign_power_cells, "positions"_a, "sites"_a, "weights"_a,
             "Cell (C,) int32 of each of positions (C,2) m: argmin_e |x - P_e|^2 - w_e over sites P (E,2) m and weights w (E,) m^2.\n\n"
             "Ties go to the smallest index. Raises ValueError naming the array for a wrong shape, for values that are not finite\n"
             "(how many, and the first index), for no site at all, and for positions so far away that squared distances overflow.");
  // Renderings may live in graphs that torch only releases at exit: nothing to warn about.
  nb::set_leak_warnings(false);
  radiant::bind_raster(module);
  bind_dense(module);
  bind_matching(module);
  bind_plan(module);
  bind_training(module);
  bind_rows(module);
}
