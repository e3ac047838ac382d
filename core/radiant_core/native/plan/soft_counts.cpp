#include "plan/soft_counts.h"

#include "plan/cell_row.h"

namespace radiant {
namespace {

constexpr double kReach = 12;        // exp(-12) = 6e-6: farther cells take nothing
constexpr double kCoarse = 3;        // change of differences in a box, in t, for one place
constexpr double kShare = 0.05;      // of its cameras that a cell needs for a step of Newton
constexpr std::size_t kMaxPairs = 12;  // beyond, a place's candidates leave the Hessian to others

using Row = CellRow<double>;

// Soft counts s (E,) and the Hessian's off-diagonal, -d s_e / d w_k, summed over places.
struct SoftCount {
  const CameraTree* tree;
  const PowerSites* sites;
  double temperature;
  std::vector<double> s;
  std::vector<Row> rows;
  std::vector<double> p;
  std::vector<std::pair<int, double>> active;  // the cells of a place, with their shares
  std::int64_t shared = 0;  // units that more than one cell takes part in

  SoftCount(const CameraTree& t, const PowerSites& power, double temp)
      : tree(&t), sites(&power), temperature(temp), s(power.size(), 0.0), rows(power.size()) {}

  bool box(const CameraBox& box, std::size_t first, std::size_t last, const int* cells, std::size_t count, double spread) {
    if (count == 1) {
      s[cells[0]] += static_cast<double>(box.cameras);
      return true;
    }
    if (spread > kCoarse * temperature) return false;
    place(box.mean_x, box.mean_y, static_cast<double>(box.cameras), static_cast<std::int64_t>(last - first), cells, count);
    return true;
  }

  void unit(std::size_t u, const int* cells, std::size_t count) { place(tree->x[u], tree->y[u], static_cast<double>(tree->cameras[u]), 1, cells, count); }

  void place(double x, double y, double mass, std::int64_t units, const int* cells, std::size_t count) {
    p.resize(count);
    double smallest = INFINITY, total = 0;
    for (std::size_t k = 0; k < count; ++k) smallest = std::min(smallest, p[k] = sites->at(cells[k], x, y));
    for (std::size_t k = 0; k < count; ++k) {
      const double gap = (p[k] - smallest) / temperature;
      total += p[k] = gap > kReach ? 0.0 : std::exp(-gap);
    }
    std::size_t taking = 0;
    active.clear();
    for (std::size_t k = 0; k < count; ++k) {
      if (p[k] == 0) continue;
      const double part = p[k] / total;
      taking += part > 1e-3;
      s[cells[k]] += mass * part;
      active.emplace_back(cells[k], part);
    }
    if (taking < 2) return;
    shared += units;
    if (taking > kMaxPairs) return;
    for (std::size_t k = 0; k < active.size(); ++k)
      for (std::size_t l = 0; l < k; ++l) {
        const auto [low, high] = std::minmax(active[k].first, active[l].first);
        rows[high][low] += mass * active[k].second * active[l].second / temperature;
      }
  }

  // The upper triangle, once all places are in; by row, which is read before it grows.
  void mirror() {
    for (std::size_t high = 0; high < rows.size(); ++high)
      for (const auto& [low, value] : rows[high]) rows[static_cast<std::size_t>(low)].append(static_cast<int>(high), value);
  }
};

// (Laplacian + n / longest) step = gradient by conjugate gradients, preconditioned by the diagonal.
// Cells that share no camera have a singular Laplacian: they move by `longest` times their lack.
std::vector<double> newton_step(const std::vector<Row>& rows, const std::vector<double>& gradient, const std::vector<std::int64_t>& wanted,
                                double longest) {
  const std::size_t n = rows.size();
  std::vector<double> diagonal(n, 0.0), step(n, 0.0), residual = gradient, direction(n), image(n);
  for (std::size_t e = 0; e < n; ++e) {
    for (const auto& [cell, value] : rows[e]) diagonal[e] += value;
    diagonal[e] += static_cast<double>(wanted[e]) / longest;
  }
  double fit = 0;
  for (std::size_t e = 0; e < n; ++e) direction[e] = residual[e] / diagonal[e], fit += residual[e] * direction[e];
  const double enough = 1e-8 * fit;
  for (std::size_t round = 0; round < 4 * n + 20 && fit > enough; ++round) {
    double curvature = 0;
    for (std::size_t e = 0; e < n; ++e) {
      double sum = diagonal[e] * direction[e];
      for (const auto& [cell, value] : rows[e]) sum -= value * direction[cell];
      image[e] = sum, curvature += sum * direction[e];
    }
    if (!(curvature > 0)) break;
    const double length = fit / curvature;
    double next = 0;
    for (std::size_t e = 0; e < n; ++e) {
      step[e] += length * direction[e], residual[e] -= length * image[e];
      next += residual[e] * residual[e] / diagonal[e];
    }
    for (std::size_t e = 0; e < n; ++e) direction[e] = residual[e] / diagonal[e] + next / fit * direction[e];
    fit = next;
  }
  return step;
}

double missed(const std::vector<double>& s, const std::vector<std::int64_t>& wanted) {
  double sum = 0;
  for (std::size_t e = 0; e < s.size(); ++e) sum += std::abs(s[e] - static_cast<double>(wanted[e]));
  return sum;
}

// Soft cameras over wanted ones of the cell that lacks most.
double least_share(const std::vector<double>& s, const std::vector<std::int64_t>& wanted) {
  double least = INFINITY;
  for (std::size_t e = 0; e < s.size(); ++e) least = std::min(least, s[e] / static_cast<double>(wanted[e]));
  return least;
}

// Largest difference of power distances anywhere in the root box, m^2.
double full_range(const CameraBox& root, const PowerSites& sites) {
  std::size_t best = 0;
  for (std::size_t e = 1; e < sites.size(); ++e)
    if (sites.at(e, root.centre_x, root.centre_y) < sites.at(best, root.centre_x, root.centre_y)) best = e;
  double range = 0;
  for (std::size_t e = 0; e < sites.size(); ++e) {
    const double reach =
        2 * (std::abs(sites.x[e] - sites.x[best]) * root.half_x + std::abs(sites.y[e] - sites.y[best]) * root.half_y);
    range = std::max(range, reach + sites.at(e, root.centre_x, root.centre_y) - sites.at(best, root.centre_x, root.centre_y));
  }
  return range;
}

// Median difference across a cell: of each site to its nearest, over half the way.
double cell_range(const PowerSites& sites, double range) {
  std::vector<double> nearest;
  for (std::size_t e = 0; e < sites.size(); ++e) {
    double least = INFINITY;
    for (std::size_t k = 0; k < sites.size(); ++k)
      if (k != e) least = std::min(least, sites.squared(k, sites.x[e], sites.y[e]));
    nearest.push_back(least);
  }
  std::nth_element(nearest.begin(), nearest.begin() + nearest.size() / 2, nearest.end());
  return std::min(range, nearest[nearest.size() / 2]);
}

}  // namespace

SoftResult fit_soft_counts(const CameraTree& tree, PowerSites& sites, const std::vector<std::int64_t>& wanted,
                           const std::vector<double>& start_weights, bool warm) {
  const std::size_t n = sites.size();
  std::vector<double> weights = start_weights;
  sites.set(weights);
  const double range = full_range(tree.levels.back()[0], sites);
  SoftResult result{weights, range, 0};
  if (n == 1 || !(range > 0)) return result;
  const auto count_at = [&](const std::vector<double>& at, double temperature) {
    sites.set(at);
    SoftCount counted(tree, sites, temperature);
    walk_cells(tree, sites, kReach * temperature, counted);
    counted.mirror();
    ++result.rounds;
    return counted;
  };
  const double total = static_cast<double>(tree.levels.back()[0].cameras);
  const double cell = cell_range(sites, range), farthest = 64 * cell * static_cast<double>(n);
  double temperature = cell / (warm ? 256 : tree.num_units() < 64 * n ? 1 : 16), longest = farthest;
  SoftCount now = count_at(weights, temperature);
  // Newton needs cells with something to lose: almost empty ones first grow alone, ever warmer.
  for (int grown = 1; grown <= 60 && least_share(now.s, wanted) < kShare; ++grown) {
    for (std::size_t e = 0; e < n; ++e)
      if (now.s[e] < 2 * kShare * static_cast<double>(wanted[e]))
        weights[e] += temperature * std::clamp(std::log(0.5 * static_cast<double>(wanted[e]) / (now.s[e] + 1e-9)), 0.5, 8.0);
    if (grown % 5 == 0) temperature = std::min(4 * temperature, range);
    now = count_at(weights, temperature);
  }
  const auto few = static_cast<std::int64_t>(std::min(12 * n, tree.num_units() / 8));
  for (int stage = 0; stage < 40; ++stage) {
    const bool last = now.shared <= few || temperature < 1e-13 * range;
    int failures = 0;
    longest = std::max(longest, 16 * cell);
    for (int tries = 0; tries < (last ? 6 : 40) && failures < (missed(now.s, wanted) > 0.05 * total ? 7 : 3) && missed(now.s, wanted) > (last ? 5e-4 : 2e-3) * total; ++tries) {
      const double before = missed(now.s, wanted), share = std::min(least_share(now.s, wanted), 0.5);
      if (share < kShare / 10) break;
      std::vector<double> step(n), next = weights;
      for (std::size_t e = 0; e < n; ++e) step[e] = static_cast<double>(wanted[e]) - now.s[e];
      step = newton_step(now.rows, step, wanted, longest);
      const double damping = std::pow(3.0, -failures);
      for (std::size_t e = 0; e < n; ++e) next[e] += damping * step[e];
      SoftCount then = count_at(next, temperature);
      if (missed(then.s, wanted) > 0.97 * before || least_share(then.s, wanted) < share / 4) {
        // The step was too long where cells hardly touch: the ridge shortens it there first.
        ++failures, longest = std::max(longest / 10, temperature / 8);
        continue;
      }
      failures = 0, longest = std::min(farthest, 4 * longest);
      weights = std::move(next);
      now = std::move(then);
    }
    if (stage < 4 && missed(now.s, wanted) > 0.2 * total && 4 * temperature < range) {
      temperature *= 16;
    } else if (last) {
      break;
    }
    temperature /= 4;
    now = count_at(weights, temperature);
  }
  result.weights = weights, result.temperature = temperature;
  return result;
}

}  // namespace radiant
