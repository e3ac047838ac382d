// The last cameras: successive shortest paths from cells with too many to those with too few.
//
// Every unit is in its cheapest cell for some weights, which is optimal for the counts that result;
// moving cameras along the cheapest chain of cells keeps that (Ahuja, Magnanti, Orlin, Network
// Flows, 1993, ch. 9). Only units within `reach` of a second cell are listed; a path is taken only
// while no unlisted unit can be cheaper, else the lists are made anew, wider.
#pragma once

#include <vector>

#include "plan/camera_tree.h"

namespace radiant {

// Who holds a unit's cameras, mostly one cell.
struct Holding {
  int cell;
  std::int64_t cameras;
};

struct Holdings {
  std::vector<int> cell_of_unit;             // (U,), or -1 - index into `split`
  std::vector<std::vector<Holding>> split;

  std::int64_t held(std::size_t unit, int cell, const CameraTree& tree) const;
  void move(std::size_t unit, int from, int to, std::int64_t cameras, const CameraTree& tree);
};

struct AugmentResult {
  Holdings holdings;
  std::vector<double> weights;
  std::int64_t paths;
  int lists;  // how often the lists were made
};

// `wanted` (E,) sums to the tree's cameras; `reach` m^2: the first band. Weights are centred.
AugmentResult augment_to_counts(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted,
                                const std::vector<double>& weights, double reach);

// By how much the worst camera misses its cell, m^2.
double largest_violation(const CameraTree& tree, PowerSites& sites, const std::vector<double>& weights, const Holdings& holdings);

}  // namespace radiant
