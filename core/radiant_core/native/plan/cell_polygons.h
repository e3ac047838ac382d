// Power cells as polygons.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace radiant {

// Cell `index` of sites (E,2) m with weights (E,) m^2 in a convex counter-clockwise outline, or
// empty. Borders that overshoot by less than `tolerance_m` do not cut. Of sites at one spot the
// heaviest has the cell, the first among equals.
std::vector<std::pair<double, double>> cell_polygon(const double* sites, const double* weights, std::size_t num_sites, std::size_t index,
                                                    const std::vector<std::pair<double, double>>& outline, double tolerance_m);

}  // namespace radiant
