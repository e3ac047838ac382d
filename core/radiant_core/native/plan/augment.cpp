#include "plan/augment.h"

#include <queue>

#include "plan/cell_row.h"

namespace radiant {

std::int64_t Holdings::held(std::size_t unit, int cell, const CameraTree& tree) const {
  const int owner = cell_of_unit[unit];
  if (owner >= 0) return owner == cell ? tree.cameras[unit] : 0;
  for (const Holding& part : split[static_cast<std::size_t>(-1 - owner)])
    if (part.cell == cell) return part.cameras;
  return 0;
}

void Holdings::move(std::size_t unit, int from, int to, std::int64_t cameras, const CameraTree& tree) {
  if (cell_of_unit[unit] == from && cameras == tree.cameras[unit]) {
    cell_of_unit[unit] = to;
    return;
  }
  if (cell_of_unit[unit] >= 0) {
    split.push_back({{cell_of_unit[unit], tree.cameras[unit]}});
    cell_of_unit[unit] = -static_cast<int>(split.size());
  }
  auto& parts = split[static_cast<std::size_t>(-1 - cell_of_unit[unit])];
  bool found = false;
  for (Holding& part : parts) {
    if (part.cell == from) part.cameras -= cameras;
    if (part.cell == to) part.cameras += cameras, found = true;
  }
  if (!found) parts.push_back({to, cameras});
  parts.erase(std::remove_if(parts.begin(), parts.end(), [](const Holding& part) { return part.cameras == 0; }), parts.end());
}

namespace {

constexpr double kRounding = 1e-14;  // error of a power distance, as a share of max |P|^2 - w

struct Entry {
  double extra;  // cost in the new cell minus cost in the old one
  std::uint32_t unit;
  bool operator<(const Entry& other) const { return extra > other.extra || (extra == other.extra && unit > other.unit); }
};

using Heap = std::vector<Entry>;  // units that may move along one arc, the cheapest first

struct HardCells {
  std::vector<int>& cell_of_unit;
  const CameraTree& tree;
  const PowerSites& sites;

  bool box(const CameraBox&, std::size_t first, std::size_t last, const int* cells, std::size_t count, double) {
    if (count > 1) return false;
    std::fill(cell_of_unit.begin() + static_cast<std::ptrdiff_t>(first), cell_of_unit.begin() + static_cast<std::ptrdiff_t>(last), cells[0]);
    return true;
  }
  void unit(std::size_t u, const int* cells, std::size_t count) {
    int best = cells[0];
    double least = INFINITY;
    for (std::size_t k = 0; k < count; ++k) {
      const double power = sites.squared(cells[k], tree.x[u], tree.y[u]) - sites.weights[cells[k]];
      if (power < least || (power == least && cells[k] < best)) least = power, best = cells[k];
    }
    cell_of_unit[u] = best;
  }
};

class Augmenter {
 public:
  Augmenter(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted, const std::vector<double>& weights,
            double reach)
      : tree_(tree), sites_(sites), w_(weights), reach_(reach), surplus_(sites.size(), 0), drift_(sites.size(), 0.0) {
    holdings_.cell_of_unit.resize(tree.num_units());
    sites_.set(w_);
    double scale = 0;
    for (std::size_t e = 0; e < sites.size(); ++e) scale = std::max(scale, std::abs(sites.q[e]));
    rounding_ = kRounding * scale;
    reach_ = std::max(reach_, rounding_);
    HardCells hard{holdings_.cell_of_unit, tree_, sites_};
    walk_cells(tree_, sites_, rounding_, hard);
    for (std::size_t u = 0; u < tree.num_units(); ++u) surplus_[holdings_.cell_of_unit[u]] += tree.cameras[u];
    for (std::size_t e = 0; e < sites.size(); ++e) surplus_[e] -= wanted[e];
  }

  AugmentResult run() {
    make_lists();
    for (std::size_t cell = 0; cell < surplus_.size(); ++cell)
      while (surplus_[cell] > 0) {
        if (take_path(static_cast<int>(cell))) continue;
        reach_ = std::max(4 * reach_, 2 * needed_);
        make_lists();
      }
    centre_weights();
    return {std::move(holdings_), w_, paths_, lists_};
  }

  // Visitor of `make_lists`.
  bool box(const CameraBox&, std::size_t, std::size_t, const int*, std::size_t count, double) { return count == 1; }
  void unit(std::size_t u, const int* cells, std::size_t count) {
    double least = INFINITY;
    power_.resize(count);
    for (std::size_t k = 0; k < count; ++k) {
      power_[k] = sites_.squared(cells[k], tree_.x[u], tree_.y[u]) - w_[cells[k]];
      least = std::min(least, power_[k]);
    }
    const std::size_t begin = near_.size();
    for (std::size_t k = 0; k < count; ++k)
      if (power_[k] <= least + reach_) near_.push_back(cells[k]);
    if (near_.size() - begin < 2) {
      near_.resize(begin);
      return;
    }
    listed_[u] = static_cast<int>(near_start_.size());
    near_start_.push_back(begin);
    push_all(u);
  }

 private:
  void push_all(std::size_t u) {
    const int owner = holdings_.cell_of_unit[u];
    if (owner >= 0) return push(u, owner);
    for (const Holding& part : holdings_.split[static_cast<std::size_t>(-1 - owner)]) push(u, part.cell);
  }

  // Lists that unit `u` of cell `from` may move to each cell near it.
  void push(std::size_t u, int from) {
    const auto at = static_cast<std::size_t>(listed_[u]);
    const std::size_t begin = near_start_[at], end = at + 1 < near_start_.size() ? near_start_[at + 1] : near_.size();
    const double here = sites_.squared(from, tree_.x[u], tree_.y[u]);
    for (std::size_t k = begin; k < end; ++k) {
      if (near_[k] == from) continue;
      Heap& heap = arcs_[from][near_[k]];
      heap.push_back({sites_.squared(near_[k], tree_.x[u], tree_.y[u]) - here, static_cast<std::uint32_t>(u)});
      if (ordered_) std::push_heap(heap.begin(), heap.end());
    }
  }

  void make_lists() {
    ++lists_;
    arcs_.assign(sites_.size(), {});
    near_.clear(), near_start_.clear();
    listed_.assign(tree_.num_units(), -1);
    std::fill(drift_.begin(), drift_.end(), 0.0), largest_drift_ = 0;
    sites_.set(w_);
    ordered_ = false;
    walk_cells(tree_, sites_, reach_ + rounding_, *this);
    ordered_ = true;
    for (auto& row : arcs_)
      for (auto& [to, heap] : row) std::make_heap(heap.begin(), heap.end());
  }

  // The cheapest unit of `from` that may move along the arc, null where there is none.
  const Entry* cheapest(int from, Heap& heap) {
    while (!heap.empty() && holdings_.held(heap.front().unit, from, tree_) == 0) {
      std::pop_heap(heap.begin(), heap.end());
      heap.pop_back();
    }
    return heap.empty() ? nullptr : &heap.front();
  }

  // Moves cameras on the cheapest chain to a cell with too few; false: lists are too narrow.
  bool take_path(int source) {
    struct Label {
      double distance;
      int cell;
      bool operator<(const Label& other) const { return distance > other.distance || (distance == other.distance && cell > other.cell); }
    };
    const std::size_t n = sites_.size();
    distance_.assign(n, INFINITY), previous_.assign(n, -1), unit_.assign(n, 0), done_.assign(n, 0);
    std::priority_queue<Label> queue;
    std::vector<int> settled;
    distance_[source] = 0;
    queue.push({0.0, source});
    int taker = -1;
    while (!queue.empty()) {
      const auto [distance, cell] = queue.top();
      queue.pop();
      if (done_[cell]) continue;
      done_[cell] = 1;
      if (surplus_[cell] < 0) {
        taker = cell;
        break;
      }
      settled.push_back(cell);
      for (auto& [to, heap] : arcs_[cell]) {
        if (done_[to]) continue;
        const Entry* entry = cheapest(cell, heap);
        if (!entry) continue;
        const double reduced = std::max(entry->extra + w_[cell] - w_[to], 0.0);
        if (distance + reduced < distance_[to]) {
          distance_[to] = distance + reduced, previous_[to] = cell, unit_[to] = entry->unit;
          queue.push({distance_[to], to});
        }
      }
    }
    needed_ = taker < 0 ? 16 * reach_ : distance_[taker] + largest_drift_;
    if (taker < 0 || needed_ > reach_) return false;
    std::int64_t amount = std::min(surplus_[source], -surplus_[taker]);
    for (int cell = taker; cell != source; cell = previous_[cell])
      amount = std::min(amount, holdings_.held(unit_[cell], previous_[cell], tree_));
    for (const int cell : settled) {
      const double change = distance_[taker] - distance_[cell];
      w_[cell] -= change, drift_[cell] += change;
      largest_drift_ = std::max(largest_drift_, drift_[cell]);
    }
    for (int cell = taker; cell != source; cell = previous_[cell]) {
      const std::size_t moved = unit_[cell];
      const bool fresh = holdings_.held(moved, cell, tree_) == 0;
      holdings_.move(moved, previous_[cell], cell, amount, tree_);
      if (fresh) push(moved, cell);
    }
    surplus_[source] -= amount, surplus_[taker] += amount, ++paths_;
    return true;
  }

  // Each weight to the middle of what its neighbours' cameras allow, so that borders run between.
  void centre_weights() {
    if (largest_drift_ > reach_ / 2) make_lists();
    struct Bound {
      int from, to;
      double extra;
    };
    std::vector<Bound> bounds;
    std::vector<std::vector<std::size_t>> of(sites_.size());
    for (std::size_t from = 0; from < arcs_.size(); ++from)
      for (auto& [to, heap] : arcs_[from])
        if (const Entry* entry = cheapest(static_cast<int>(from), heap)) {
          of[from].push_back(bounds.size()), of[to].push_back(bounds.size());
          bounds.push_back({static_cast<int>(from), to, entry->extra});
        }
    // Unlisted pairs stay apart by reach - drift; each cell may come closer by a quarter of that.
    const double step = std::max(reach_ - largest_drift_, 0.0) / 4;
    const std::vector<double> start = w_;
    for (int sweep = 0; sweep < 8; ++sweep)
      for (std::size_t e = 0; e < w_.size(); ++e) {
        double low = start[e] - step, high = start[e] + step;
        for (const std::size_t b : of[e]) {
          if (bounds[b].to == static_cast<int>(e)) high = std::min(high, w_[bounds[b].from] + bounds[b].extra);
          else low = std::max(low, w_[bounds[b].to] - bounds[b].extra);
        }
        if (low < high) w_[e] = (low + high) / 2;
      }
  }

  const CameraTree& tree_;
  PowerSites& sites_;
  std::vector<double> w_;
  double reach_, rounding_ = 0, largest_drift_ = 0, needed_ = 0;
  std::vector<std::int64_t> surplus_;
  std::vector<double> drift_;
  Holdings holdings_;
  std::vector<CellRow<Heap>> arcs_;
  std::vector<int> near_, listed_;
  std::vector<std::size_t> near_start_;
  bool ordered_ = false;
  std::vector<double> power_, distance_;
  std::vector<int> previous_;
  std::vector<std::uint32_t> unit_;
  std::vector<char> done_;
  std::int64_t paths_ = 0;
  int lists_ = 0;
};

struct Violation {
  const CameraTree& tree;
  const PowerSites& sites;
  const Holdings& holdings;
  double worst = 0;

  bool box(const CameraBox&, std::size_t first, std::size_t last, const int* cells, std::size_t count, double) {
    if (count > 1) return false;
    for (std::size_t u = first; u < last; ++u)
      if (holdings.cell_of_unit[u] != cells[0]) unit(u, cells, count);
    return true;
  }
  void unit(std::size_t u, const int* cells, std::size_t count) {
    double least = INFINITY;
    for (std::size_t k = 0; k < count; ++k) least = std::min(least, power(cells[k], u));
    const int owner = holdings.cell_of_unit[u];
    if (owner >= 0) {
      worst = std::max(worst, power(owner, u) - least);
      return;
    }
    for (const Holding& part : holdings.split[static_cast<std::size_t>(-1 - owner)]) worst = std::max(worst, power(part.cell, u) - least);
  }
  double power(int cell, std::size_t u) const { return sites.squared(cell, tree.x[u], tree.y[u]) - sites.weights[cell]; }
};

}  // namespace

AugmentResult augment_to_counts(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted,
                                const std::vector<double>& weights, double reach) {
  return Augmenter(tree, sites, wanted, weights, reach).run();
}

double largest_violation(const CameraTree& tree, PowerSites& sites, const std::vector<double>& weights, const Holdings& holdings) {
  sites.set(weights);
  double scale = 0;
  for (const double q : sites.q) scale = std::max(scale, std::abs(q));
  Violation seen{tree, sites, holdings};
  walk_cells(tree, sites, kRounding * scale, seen);
  return seen.worst;
}

}  // namespace radiant
