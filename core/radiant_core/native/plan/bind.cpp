// Cameras dealt to cells with given counts at the least sum of squared distances. The arrays were
// checked in Python (plan.regions.transport); here only shapes, which decide what is read.
#include "plan/bind.h"

#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>

#include <cstdint>
#include <memory>
#include <vector>

#include "plan/cell_polygons.h"
#include "plan/deal.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

using Numbers = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Counts = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using radiant::CameraTree;

template <class Value, class... Shape>
auto numpy_of(std::vector<Value>&& values, Shape... shape) {
  auto* kept = new std::vector<Value>(std::move(values));
  nb::capsule owner(kept, [](void* pointer) noexcept { delete static_cast<std::vector<Value>*>(pointer); });
  return nb::ndarray<nb::numpy, Value>(kept->data(), {static_cast<std::size_t>(shape)...}, owner);
}

// Cell (C,) of each input row, or -1, and (row, cell, cameras) triples of rows of several cells.
void expand(const CameraTree& tree, const radiant::Holdings& holdings, const std::int64_t* multiplicities, std::vector<std::int32_t>& cells,
            std::vector<std::int64_t>& splits) {
  for (std::size_t u = 0; u < tree.num_units(); ++u) {
    const int owner = holdings.cell_of_unit[u];
    if (owner >= 0) {
      for (std::size_t i = tree.first_input[u]; i < tree.first_input[u + 1]; ++i) cells[tree.inputs[i]] = owner;
      continue;
    }
    auto parts = holdings.split[static_cast<std::size_t>(-1 - owner)];
    std::size_t part = 0;
    for (std::size_t i = tree.first_input[u]; i < tree.first_input[u + 1]; ++i) {
      const std::uint32_t row = tree.inputs[i];
      std::int64_t left = multiplicities ? multiplicities[row] : 1;
      if (left <= parts[part].cameras) cells[row] = parts[part].cell;
      while (left > 0) {
        const std::int64_t taken = std::min(left, parts[part].cameras);
        if (cells[row] < 0) splits.insert(splits.end(), {static_cast<std::int64_t>(row), parts[part].cell, taken});
        left -= taken, parts[part].cameras -= taken;
        if (parts[part].cameras == 0) ++part;
      }
    }
  }
}

void require(bool fits, const char* message) {
  if (!fits) throw nb::value_error(message);
}

nb::tuple deal_to_cells(const Numbers& positions, nb::object multiplicities, const Numbers& sites, const Counts& counts,
                        const Numbers& start_weights, bool warm) {
  require(positions.ndim() == 2 && positions.shape(1) == 2, "positions must have the shape (C, 2)");
  require(sites.ndim() == 2 && sites.shape(1) == 2 && sites.shape(0) > 0, "sites must have the shape (E, 2), E at least 1");
  const std::size_t num_positions = positions.shape(0), num_sites = sites.shape(0);
  require(num_positions > 0 && num_positions < (std::size_t{1} << 31), "positions must hold 1 to 2^31 - 1 rows");
  require(counts.shape(0) == num_sites, "counts must have the shape (E,)");
  require(start_weights.ndim() == 1 && start_weights.shape(0) == num_sites, "start_weights must have the shape (E,)");
  const std::int64_t* of_row = nullptr;
  Counts given;
  if (!multiplicities.is_none()) {
    given = nb::cast<Counts>(multiplicities);
    require(given.shape(0) == num_positions, "multiplicities must have the shape (C,)");
    of_row = given.data();
  }
  std::int64_t wanted_sum = 0, given_sum = 0;
  for (std::size_t e = 0; e < num_sites; ++e) require(counts.data()[e] > 0, "counts must be positive"), wanted_sum += counts.data()[e];
  for (std::size_t row = 0; row < num_positions; ++row) given_sum += of_row ? of_row[row] : 1;
  require(wanted_sum == given_sum, "counts must sum to the cameras given");

  std::vector<std::int32_t> cells(num_positions, -1);
  std::vector<std::int64_t> splits;
  std::vector<double> weights(start_weights.data(), start_weights.data() + num_sites);
  double violation = 0;
  std::int64_t rounds = 0, paths = 0;
  {
    nb::gil_scoped_release unlocked;
    const CameraTree tree(positions.data(), of_row, num_positions);
    radiant::PowerSites power(sites.data(), num_sites);
    const std::vector<std::int64_t> wanted(counts.data(), counts.data() + num_sites);
    radiant::AugmentResult dealt = radiant::deal_to_cells(tree, power, wanted, weights, warm, rounds);
    violation = radiant::largest_violation(tree, power, dealt.weights, dealt.holdings);
    expand(tree, dealt.holdings, of_row, cells, splits);
    weights = std::move(dealt.weights), paths = dealt.paths;
  }
  const std::size_t num_splits = splits.size() / 3;
  return nb::make_tuple(numpy_of(std::move(cells), num_positions), numpy_of(std::move(splits), num_splits, 3),
                        numpy_of(std::move(weights), num_sites), violation, rounds, paths);
}

nb::list cell_polygons(const Numbers& sites, const Numbers& weights, const Numbers& outline, double tolerance_m) {
  require(sites.ndim() == 2 && sites.shape(1) == 2, "sites must have the shape (E, 2)");
  require(weights.ndim() == 1 && weights.shape(0) == sites.shape(0), "weights must have the shape (E,)");
  require(outline.ndim() == 2 && outline.shape(1) == 2, "outline must have the shape (V, 2)");
  std::vector<std::pair<double, double>> corners;
  for (std::size_t v = 0; v < outline.shape(0); ++v) corners.emplace_back(outline.data()[2 * v], outline.data()[2 * v + 1]);
  nb::list polygons;
  for (std::size_t e = 0; e < sites.shape(0); ++e) {
    std::vector<double> flat;
    for (const auto& [x, y] : radiant::cell_polygon(sites.data(), weights.data(), sites.shape(0), e, corners, tolerance_m))
      flat.insert(flat.end(), {x, y});
    const std::size_t rows = flat.size() / 2;
    polygons.append(numpy_of(std::move(flat), rows, 2));
  }
  return polygons;
}

}  // namespace

void bind_plan(nb::module_& module) {
  module.def("deal_to_cells", &deal_to_cells, "positions"_a, "multiplicities"_a.none(), "sites"_a, "counts"_a, "start_weights"_a, "warm"_a,
             "Cells (C,) int32 of positions (C,2) m with exactly counts (E,) cameras per site (E,2) m at the least sum of squared distances.\n\n"
             "Also rows of several cells (S,3) as (row, cell, cameras), their cell being -1; weights (E,) m^2 of the power diagram that\n"
             "has these cells; by how much the worst camera misses its cell, m^2; rounds of Newton; augmenting paths.");
  module.def("cell_polygons", &cell_polygons, "sites"_a, "weights"_a, "outline"_a, "tolerance_m"_a,
             "Cells of sites (E,2) m with weights (E,) m^2 as polygons (V,2) in a convex counter-clockwise outline (V,2); (0,2) where empty.");
}
