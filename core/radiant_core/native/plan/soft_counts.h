// Weights whose power cells hold about the wanted cameras: damped Newton on the smoothed dual
//
// g_t(w) = -t Σ_u m_u log Σ_e exp(-f_e(x_u)/t) + Σ_e n_e w_e
// dg/dw_e = n_e - s_e,   s_e = Σ_u m_u p_e(x_u)
//
// with p = softmax(-f/t), concave and smooth for every t > 0; t falls until a border's band holds a
// few cameras. Boxes in which no difference of candidates changes by more than a few t are one
// place. Where a cell lacks nearly all cameras the augmenting paths do the rest.
#pragma once

#include <vector>

#include "plan/camera_tree.h"

namespace radiant {

struct SoftResult {
  std::vector<double> weights;
  double temperature;  // m^2 of the last round
  int rounds;          // how often cameras were counted
};

// `wanted` (E,) > 0, summing to the tree's cameras. `warm`: start_weights are nearly right.
SoftResult fit_soft_counts(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted,
                           const std::vector<double>& start_weights, bool warm);

}  // namespace radiant
