// Cameras dealt to power cells with given counts at the least sum of squared distances.
#pragma once

#include "plan/augment.h"
#include "plan/soft_counts.h"

namespace radiant {

// Solved on ever finer boxes of cameras as if at one place: the weights of one level are nearly
// right on the next. `warm`: start_weights are nearly right, and the coarsest level starts cool.
AugmentResult deal_to_cells(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted,
                            const std::vector<double>& start_weights, bool warm, std::int64_t& rounds);

}  // namespace radiant
