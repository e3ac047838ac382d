// Rounded as written (CMake): a point within rounding of a limit is kept by every machine or none.
#include "dense/agree.h"

#include <cmath>

namespace radiant {

namespace {

struct Point {
  double x, y, z;
};

// The point at inverse depth w of a pixel: R^T ((x - cx, y - cy) / f, 1) / w - t).
Point to_world(const PlaneView& view, double x, double y, double w) {
  const double* p = view.pose;
  const double a = (x - view.center_x) / view.focal_x / w - p[3], b = (y - view.center_y) / view.focal_y / w - p[7], c = 1 / w - p[11];
  return {p[0] * a + p[4] * b + p[8] * c, p[1] * a + p[5] * b + p[9] * c, p[2] * a + p[6] * b + p[10] * c};
}

// Pixel and depth of a point; the pixel only counts where the depth is positive.
Point to_image(const PlaneView& view, const Point& at) {
  const double* p = view.pose;
  const double z = p[8] * at.x + p[9] * at.y + p[10] * at.z + p[11];
  return {(p[0] * at.x + p[1] * at.y + p[2] * at.z + p[3]) / z * view.focal_x + view.center_x,
          (p[4] * at.x + p[5] * at.y + p[6] * at.z + p[7]) / z * view.focal_y + view.center_y, z};
}

// Inverse depth at a pixel by the plane of the nearest node; not positive where there is none.
double inverse_depth_at(const PlaneView& view, double x, double y) {
  const double column = std::nearbyint((x - view.first) / view.step), row = std::nearbyint((y - view.first) / view.step);
  // Written so that a NaN is outside.
  if (!(column >= 0 && row >= 0 && column < static_cast<double>(view.columns) && row < static_cast<double>(view.rows))) return 0;
  const std::int64_t nodes = view.rows * view.columns;
  const float* at = view.planes + static_cast<std::int64_t>(row) * view.columns + static_cast<std::int64_t>(column);
  if (!(at[0] > 0)) return 0;
  return at[0] + at[nodes] * (x - (view.first + view.step * column)) + at[2 * nodes] * (y - (view.first + view.step * row));
}

}  // namespace

void sum_agreeing(const PlaneView& own, const float* costs, const std::vector<PlaneView>& others, const AgreeLimits& limits, double* sums,
                  std::int32_t* counts) {
  const std::int64_t nodes = own.rows * own.columns;
  for (std::int64_t node = 0; node < nodes; ++node) {
    const double w = own.planes[node];
    const bool is_flat = std::isfinite(own.planes[nodes + node]) && std::isfinite(own.planes[2 * nodes + node]);
    Point sum{0, 0, 0};
    std::int32_t count = 0;
    if (w > 0 && is_flat && costs[node] < limits.cost) {
      const double x = own.first + own.step * static_cast<double>(node % own.columns);
      const double y = own.first + own.step * static_cast<double>(node / own.columns);
      const Point mine = to_world(own, x, y, w);
      sum = mine;
      for (const PlaneView& other : others) {
        const Point seen = to_image(other, mine);
        if (!(seen.z > 0)) continue;
        const double theirs_w = inverse_depth_at(other, seen.x, seen.y);
        if (!(theirs_w > 0)) continue;
        const Point theirs = to_world(other, seen.x, seen.y, theirs_w), back = to_image(own, theirs);
        const double dx = back.x - x, dy = back.y - y;
        if (!(back.z > 0 && std::fabs(back.z * w - 1) < limits.depths && dx * dx + dy * dy < limits.pixels * limits.pixels)) continue;
        sum.x += theirs.x, sum.y += theirs.y, sum.z += theirs.z;
        ++count;
      }
    }
    sums[3 * node] = sum.x, sums[3 * node + 1] = sum.y, sums[3 * node + 2] = sum.z;
    counts[node] = count;
  }
}

}  // namespace radiant
