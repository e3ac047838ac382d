// Gaussians to ellipses in the image: EWA projection (Zwicker 2002), 16 Gaussians at a time.
//
//     Σ' = J W R S Sᵀ Rᵀ Wᵀ Jᵀ + 0.3 px² I
//     det Σ = (fx fy / z²)² Σ_k (s_i s_j)² ((x/z, y/z, 1) · W r_k)²
// with r_k the axes of a Gaussian, s their lengths: a sum of squares, so flat and needle-like
// Gaussians keep all digits. Centres go through float64 (once per Gaussian): float32 world
// coordinates would shift them by up to 1e-3 px. The Jacobian is taken at x/z, y/z clamped to 0.15
// image sizes outside the image and differentiated as computed: `_jacobians` in torch_reference.py
// says why.
#pragma once

#include "machine/simd_math.h"
#include "machine/simd_rows.h"
#include "raster/types.h"

namespace radiant::RADIANT_ISA {

// The part of the projection that both directions need. Lanes not `usable` hold harmless numbers.
struct Geometry {
  F ratio_x, ratio_y, inverse_z;            // x/z, y/z, 1/z (z = 1 where out of range)
  F clamped_x, clamped_y;                   // where the Jacobian is taken
  Mask free_x, free_y;                      // the ratio itself is inside the window
  F quat[4], inverse_norm;                  // unit quaternion, 1/|q| (0 for a zero one)
  F rotation[9];                            // of the Gaussian
  F axes[9];                                // W R: axes in the camera, column k = axis k
  F log_scales[3], scales[3];
  F half_x[3], half_y[3];                   // rows of J W R S
  F xx, xy, yy, determinant;                // before dilation
  F dilated_xx, dilated_yy, dilated_determinant;
  Mask usable;
  float whole_x[kLanes], whole_y[kLanes], rest_x[kLanes], rest_y[kLanes], depth[kLanes], depth_rest[kLanes], means2d[2 * kLanes];
};

// Centres in float64: fills ratio_*, inverse_z, the arrays, and `usable` with near < z < far.
RADIANT_INLINE void project_centers(const View& view, const float* means, int64_t first, int lanes, Geometry& g) {
  alignas(64) float ratio_x[kLanes], ratio_y[kLanes], inverse_z[kLanes];
  alignas(64) int32_t in_range[kLanes];
  alignas(64) double world[3][kLanes];
  const float* from = means + 3 * first;
  for (int lane = 0; lane < kLanes; ++lane) {
    const float* row = from + 3 * (lane < lanes ? lane : lanes - 1);
    for (int axis = 0; axis < 3; ++axis) world[axis][lane] = row[axis];
  }
  const double *R = view.rotation, *t = view.translation;
  // Loops without branches over arrays of their own: so gcc makes vectors of them.
  alignas(64) double x[kLanes], y[kLanes], z[kLanes], inverse[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    x[lane] = R[0] * world[0][lane] + R[1] * world[1][lane] + R[2] * world[2][lane] + t[0];
    y[lane] = R[3] * world[0][lane] + R[4] * world[1][lane] + R[5] * world[2][lane] + t[1];
    z[lane] = R[6] * world[0][lane] + R[7] * world[1][lane] + R[8] * world[2][lane] + t[2];
  }
  const double near_m = view.near_m, far_m = view.far_m;
  for (int lane = 0; lane < kLanes; ++lane) {
    const bool inside = (z[lane] > near_m) & (z[lane] < far_m);
    in_range[lane] = inside ? 1 : 0;
    inverse[lane] = 1.0 / (inside ? z[lane] : 1.0);
  }
  const double fx = view.fx, fy = view.fy, cx = view.cx, cy = view.cy;
  alignas(64) float whole_x[kLanes], whole_y[kLanes], rest_x[kLanes], rest_y[kLanes], mean_x[kLanes], mean_y[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    const double u = x[lane] * inverse[lane], v = y[lane] * inverse[lane];
    const double mx = fx * u + cx, my = fy * v + cy;
    // Far outside the image any whole part will do: the Gaussian is culled or needs no digits.
    const double near_x = mx < -1e6 ? -1e6 : mx > 1e6 ? 1e6 : mx, near_y = my < -1e6 ? -1e6 : my > 1e6 ? 1e6 : my;
    const int32_t int_x = static_cast<int32_t>(near_x), int_y = static_cast<int32_t>(near_y);
    inverse_z[lane] = static_cast<float>(inverse[lane]);
    ratio_x[lane] = static_cast<float>(u);
    ratio_y[lane] = static_cast<float>(v);
    whole_x[lane] = static_cast<float>(int_x);
    whole_y[lane] = static_cast<float>(int_y);
    rest_x[lane] = static_cast<float>(mx - int_x);
    rest_y[lane] = static_cast<float>(my - int_y);
    mean_x[lane] = static_cast<float>(mx);
    mean_y[lane] = static_cast<float>(my);
  }
  for (int lane = 0; lane < kLanes; ++lane) {
    const float rounded = static_cast<float>(z[lane]);
    g.depth[lane] = rounded;
    g.depth_rest[lane] = static_cast<float>(z[lane] - static_cast<double>(rounded));
    g.means2d[2 * lane] = mean_x[lane];
    g.means2d[2 * lane + 1] = mean_y[lane];
  }
  store(g.whole_x, load(whole_x)), store(g.whole_y, load(whole_y)), store(g.rest_x, load(rest_x)), store(g.rest_y, load(rest_y));
  g.ratio_x = load(ratio_x);
  g.ratio_y = load(ratio_y);
  g.inverse_z = load(inverse_z);
  g.usable = (broadcast(int32_t{0}) < load(in_range)) & mask_of((1u << lanes) - 1);
}

RADIANT_INLINE void rotate(const View& view, const float* quats, int64_t first, int lanes, Geometry& g) {
  F q[4];
  load_fields<4>(quats, first, lanes, q);
  const F largest = max(max(abs(q[0]), abs(q[1])), max(abs(q[2]), abs(q[3])));
  const Mask nonzero = broadcast(0.0f) < largest;
  // Scaled by the largest entry: no square overflows; below 1e-36 the inverse itself would.
  const F scale = 1.0f / select(nonzero, max(largest, broadcast(1e-36f)), broadcast(1.0f));
  for (int k = 0; k < 4; ++k) q[k] = select(nonzero, q[k] * scale, broadcast(k == 0 ? 1.0f : 0.0f));
  const F norm2 = fma(q[3], q[3], dot(q[0], q[0], q[1], q[1], q[2], q[2]));
  const F inverse = 1.0f / sqrt(max(norm2, broadcast(1e-30f)));
  for (int k = 0; k < 4; ++k) g.quat[k] = q[k] * inverse;
  g.inverse_norm = keep(nonzero, scale * inverse);
  const F &w = g.quat[0], &x = g.quat[1], &y = g.quat[2], &z = g.quat[3];
  F* R = g.rotation;
  R[0] = 1.0f - 2.0f * (y * y + z * z), R[1] = 2.0f * (x * y - w * z), R[2] = 2.0f * (x * z + w * y);
  R[3] = 2.0f * (x * y + w * z), R[4] = 1.0f - 2.0f * (x * x + z * z), R[5] = 2.0f * (y * z - w * x);
  R[6] = 2.0f * (x * z - w * y), R[7] = 2.0f * (y * z + w * x), R[8] = 1.0f - 2.0f * (x * x + y * y);
  for (int row = 0; row < 3; ++row)
    for (int k = 0; k < 3; ++k)
      g.axes[3 * row + k] = dot(broadcast(static_cast<float>(view.rotation[3 * row])), R[k], broadcast(static_cast<float>(view.rotation[3 * row + 1])),
                                R[3 + k], broadcast(static_cast<float>(view.rotation[3 * row + 2])), R[6 + k]);
}

RADIANT_INLINE void project_covariance(const View& view, const float* log_scales, int64_t first, int lanes, Geometry& g) {
  const float fx = static_cast<float>(view.fx), fy = static_cast<float>(view.fy);
  const double margin_x = 0.15 * view.width / view.fx, margin_y = 0.15 * view.height / view.fy;
  const F low_x = broadcast(static_cast<float>(-view.cx / view.fx - margin_x)), low_y = broadcast(static_cast<float>(-view.cy / view.fy - margin_y));
  const F high_x = broadcast(static_cast<float>((view.width - view.cx) / view.fx + margin_x));
  const F high_y = broadcast(static_cast<float>((view.height - view.cy) / view.fy + margin_y));
  g.clamped_x = clamp(g.ratio_x, low_x, high_x);
  g.clamped_y = clamp(g.ratio_y, low_y, high_y);
  g.free_x = (low_x <= g.ratio_x) & (g.ratio_x <= high_x);
  g.free_y = (low_y <= g.ratio_y) & (g.ratio_y <= high_y);
  load_fields<3>(log_scales, first, lanes, g.log_scales);
  const F scale_x = fx * g.inverse_z, scale_y = fy * g.inverse_z;
  F largest = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    g.scales[k] = exp(g.log_scales[k]);
    g.half_x[k] = g.scales[k] * scale_x * fnma(g.clamped_x, g.axes[6 + k], g.axes[k]);
    g.half_y[k] = g.scales[k] * scale_y * fnma(g.clamped_y, g.axes[6 + k], g.axes[3 + k]);
    largest = max(largest, max(abs(g.half_x[k]), abs(g.half_y[k])));
    // An infinite scale times 0 is no number, which the maximum above may drop.
    g.usable = g.usable & (g.scales[k] < broadcast(1e30f));
  }
  g.usable = g.usable & (largest < broadcast(kMaxHalfAxisPx));
  for (int k = 0; k < 3; ++k) g.half_x[k] = keep(g.usable, g.half_x[k]), g.half_y[k] = keep(g.usable, g.half_y[k]);
  const F *x = g.half_x, *y = g.half_y;
  g.xx = dot(x[0], x[0], x[1], x[1], x[2], x[2]);
  g.xy = dot(x[0], y[0], x[1], y[1], x[2], y[2]);
  g.yy = dot(y[0], y[0], y[1], y[1], y[2], y[2]);
  const F area = scale_x * scale_y;
  g.determinant = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    const F along = fma(g.clamped_x, g.axes[k], fma(g.clamped_y, g.axes[3 + k], g.axes[6 + k]));
    const F minor = g.scales[(k + 1) % 3] * (g.scales[(k + 2) % 3] * area) * along;
    g.determinant = fma(minor, minor, g.determinant);
  }
  g.dilated_xx = g.xx + kDilationPx2;
  g.dilated_yy = g.yy + kDilationPx2;
  g.dilated_determinant = g.determinant + kDilationPx2 * (g.xx + g.yy) + kDilationPx2 * kDilationPx2;
  g.usable = g.usable & (g.dilated_determinant < broadcast(1e37f));
  g.dilated_determinant = select(g.usable, g.dilated_determinant, broadcast(1.0f));
  g.determinant = keep(g.usable, g.determinant);
  for (int k = 0; k < 3; ++k) g.scales[k] = keep(g.usable, g.scales[k]);
}

RADIANT_INLINE void project_geometry(const View& view, const SplatArrays& splats, int64_t first, int lanes, Geometry& g) {
  project_centers(view, splats.means, first, lanes, g);
  rotate(view, splats.quats, first, lanes, g);
  project_covariance(view, splats.log_scales, first, lanes, g);
}

// σ(x) and σ(−x), each without cancellation.
RADIANT_INLINE void sigmoids(const F& x, F& positive, F& negative) {
  const F e = exp(-abs(x)), large = 1.0f / (1.0f + e), small = e * large;
  const Mask above = broadcast(0.0f) <= x;
  positive = select(above, large, small);
  negative = select(above, small, large);
}

// √(det Σ / det Σ'), with the floor of the reference.
RADIANT_INLINE F compensation(const Geometry& g) { return sqrt(max(g.determinant / g.dilated_determinant, broadcast(1e-12f))); }

}  // namespace radiant::RADIANT_ISA
