// Which cell of a power diagram each position lies in.
#pragma once

#include <cstddef>
#include <cstdint>

namespace radiant {

// Writes to `cells` (C,) for each of `positions` (C,2) m the index of argmin_e |x - P_e|^2 - w_e
// over `sites` P (E,2) m and `weights` w (E,) m^2, ties to the smallest. Inputs are finite, E >= 1.
// Returns C, or the first position whose smallest power distance overflows.
std::size_t assign_power_cells(const double* positions, std::size_t num_positions, const double* sites, const double* weights,
                               std::size_t num_sites, std::int32_t* cells);

}  // namespace radiant
