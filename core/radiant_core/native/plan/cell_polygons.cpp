// Power cells as polygons: a convex outline cut by the border it crosses farthest. O(E^2) for all.
#include "plan/cell_polygons.h"

#include <cmath>

namespace radiant {
namespace {

using Polygon = std::vector<std::pair<double, double>>;

// The part with nx x + ny y <= offset, turning as before; empty where no area is left.
Polygon clipped(const Polygon& polygon, double nx, double ny, double offset) {
  Polygon kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const auto& here = polygon[i];
    const auto& there = polygon[(i + 1) % polygon.size()];
    const double low = here.first * nx + here.second * ny - offset, high = there.first * nx + there.second * ny - offset;
    if (low <= 0) kept.push_back(here);
    if (std::fmin(low, high) < 0 && std::fmax(low, high) > 0) {
      const double share = low / (low - high);
      kept.emplace_back(here.first + (there.first - here.first) * share, here.second + (there.second - here.second) * share);
    }
  }
  return kept.size() > 2 ? kept : Polygon{};
}

struct Border {
  double nx, ny, offset, length;
  bool open;
};

}  // namespace

Polygon cell_polygon(const double* sites, const double* weights, std::size_t num_sites, std::size_t index, const Polygon& outline,
                     double tolerance_m) {
  const double x = sites[2 * index], y = sites[2 * index + 1];
  std::vector<Border> borders(num_sites);
  for (std::size_t e = 0; e < num_sites; ++e) {
    const double dx = sites[2 * e] - x, dy = sites[2 * e + 1] - y;
    const double offset = dx * (sites[2 * e] + x) + dy * (sites[2 * e + 1] + y) - weights[e] + weights[index];
    borders[e] = {2 * dx, 2 * dy, offset, 2 * std::hypot(dx, dy), dx != 0 || dy != 0};
    if (!borders[e].open && (offset < 0 || (offset == 0 && e < index))) return {};
  }
  Polygon polygon = outline;
  while (!polygon.empty()) {
    double farthest = tolerance_m;
    Border* worst = nullptr;
    for (Border& border : borders) {
      if (!border.open) continue;
      double overshoot = -INFINITY;
      for (const auto& corner : polygon) overshoot = std::fmax(overshoot, corner.first * border.nx + corner.second * border.ny - border.offset);
      if (overshoot > farthest * border.length) farthest = overshoot / border.length, worst = &border;
    }
    if (!worst) break;
    polygon = clipped(polygon, worst->nx, worst->ny, worst->offset);
    worst->open = false;
  }
  return polygon;
}

}  // namespace radiant
