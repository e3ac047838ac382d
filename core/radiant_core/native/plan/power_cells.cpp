// cell(x) = argmin_e |x - P_e|^2 - w_e, O(C E) without memory; once per candidate plan.
#include "plan/power_cells.h"

#include <cmath>

namespace radiant {

std::size_t assign_power_cells(const double* positions, std::size_t num_positions, const double* sites, const double* weights,
                               std::size_t num_sites, std::int32_t* cells) {
  for (std::size_t c = 0; c < num_positions; ++c) {
    const double x = positions[2 * c], y = positions[2 * c + 1];
    double best = INFINITY;
    std::size_t cell = 0;
    for (std::size_t e = 0; e < num_sites; ++e) {
      // Differences first: |x|^2 - 2 x.P + |P|^2 would lose 7 of 16 digits at UTM northings.
      const double dx = x - sites[2 * e], dy = y - sites[2 * e + 1];
      const double power_distance = (dx * dx + dy * dy) - weights[e];
      if (power_distance < best) {
        best = power_distance;
        cell = e;
      }
    }
    if (!std::isfinite(best)) return c;
    cells[c] = static_cast<std::int32_t>(cell);
  }
  return num_positions;
}

}  // namespace radiant
