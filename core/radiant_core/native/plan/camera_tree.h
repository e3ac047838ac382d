// Cameras in a tree of boxes, and a walk that meets only the power cells that matter at each place.
//
// With f_e(x) = |x - P_e|^2 - w_e a difference f_e - f_b is linear in x, so over a box it is
// bounded exactly by its value at the centre and the box's sides: whole boxes in one cell are met
// once. Built once per plan in O(U log U), walked some twenty times per plan.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace radiant {

// A box of cameras: centre, half sides, centroid and number, about the tree's origin.
struct CameraBox {
  double centre_x, centre_y, half_x, half_y;
  double mean_x, mean_y;
  std::int64_t cameras;
};

// Distinct positions ("units") along a space-filling curve, eight to a leaf, four boxes per box.
struct CameraTree {
  static constexpr std::size_t kLeaf = 8, kFan = 4;

  std::vector<double> x, y;              // (U,) of each unit
  std::vector<std::int64_t> cameras;     // (U,) cameras at that unit
  std::vector<std::size_t> first_input;  // (U+1,) into `inputs`
  std::vector<std::uint32_t> inputs;     // rows of the input in order of the units
  std::vector<std::vector<CameraBox>> levels;  // levels[0] are the leaves, the last has one box

  // positions (C,2); multiplicities (C,), or null for ones; rows without cameras have no unit.
  CameraTree(const double* positions, const std::int64_t* multiplicities, std::size_t num_positions);

  std::size_t num_units() const { return x.size(); }
  // Units of a box: first and one past the last.
  std::pair<std::size_t, std::size_t> units_of(std::size_t level, std::size_t index) const;
};

// Power distances without |x|^2: q_e - 2 x.P_e.
struct PowerSites {
  std::vector<double> x, y, weights, q;

  PowerSites(const double* sites, std::size_t num_sites) : x(num_sites), y(num_sites), weights(num_sites), q(num_sites) {
    for (std::size_t e = 0; e < num_sites; ++e) x[e] = sites[2 * e], y[e] = sites[2 * e + 1];
  }
  std::size_t size() const { return x.size(); }
  void set(const std::vector<double>& new_weights) {
    weights = new_weights;
    for (std::size_t e = 0; e < size(); ++e) q[e] = x[e] * x[e] + y[e] * y[e] - weights[e];
  }
  double at(std::size_t e, double px, double py) const { return q[e] - 2 * (px * x[e] + py * y[e]); }
  // |x - P_e|^2, differences first, for comparisons that must hold to the last digits.
  double squared(std::size_t e, double px, double py) const {
    const double dx = px - x[e], dy = py - y[e];
    return dx * dx + dy * dy;
  }
};

// Calls visitor.box(box, first unit, one past the last, sites, count, spread) with the sites within
// `margin` of the smallest power distance somewhere in the box, the centre's nearest first;
// `spread` bounds the change of their differences in the box. It returns whether the box is done;
// else boxes below follow and at last visitor.unit(unit, sites, count).
template <class Visitor>
class CellWalk {
 public:
  CellWalk(const CameraTree& tree, const PowerSites& sites, double margin, Visitor& visitor)
      : tree_(tree), sites_(sites), margin_(margin), visitor_(visitor) {}

  void run() {
    candidates_.resize(sites_.size());
    for (std::size_t e = 0; e < sites_.size(); ++e) candidates_[e] = static_cast<int>(e);
    if (tree_.num_units() > 0) descend(tree_.levels.size() - 1, 0, 0, candidates_.size());
  }

 private:
  void descend(std::size_t level, std::size_t index, std::size_t begin, std::size_t end) {
    const CameraBox& box = tree_.levels[level][index];
    values_.resize(end - begin);
    std::size_t nearest = begin;
    double smallest = INFINITY;
    for (std::size_t k = begin; k < end; ++k) {
      const double value = sites_.at(candidates_[k], box.centre_x, box.centre_y);
      values_[k - begin] = value;
      if (value < smallest) smallest = value, nearest = k;
    }
    const int best = candidates_[nearest];
    const std::size_t kept = candidates_.size();
    candidates_.push_back(best);
    double spread = 0;
    for (std::size_t k = begin; k < end; ++k) {
      const int e = candidates_[k];
      if (e == best) continue;
      const double reach =
          2 * (std::abs(sites_.x[e] - sites_.x[best]) * box.half_x + std::abs(sites_.y[e] - sites_.y[best]) * box.half_y);
      if (values_[k - begin] - smallest - reach > margin_) continue;
      candidates_.push_back(e);
      spread = std::max(spread, reach);
    }
    const std::size_t kept_end = candidates_.size();
    const auto [first, last] = tree_.units_of(level, index);
    if (!visitor_.box(box, first, last, candidates_.data() + kept, kept_end - kept, spread)) {
      if (level == 0) {
        for (std::size_t unit = first; unit < last; ++unit) visitor_.unit(unit, candidates_.data() + kept, kept_end - kept);
      } else {
        const std::size_t child_end = std::min((index + 1) * CameraTree::kFan, tree_.levels[level - 1].size());
        for (std::size_t child = index * CameraTree::kFan; child < child_end; ++child) descend(level - 1, child, kept, kept_end);
      }
    }
    candidates_.resize(kept);
  }

  const CameraTree& tree_;
  const PowerSites& sites_;
  double margin_;
  Visitor& visitor_;
  std::vector<int> candidates_;
  std::vector<double> values_;
};

template <class Visitor>
void walk_cells(const CameraTree& tree, const PowerSites& sites, double margin, Visitor& visitor) {
  CellWalk<Visitor>(tree, sites, margin, visitor).run();
}

}  // namespace radiant
