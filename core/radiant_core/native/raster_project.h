// Gaussians to footprints and back: EWA projection, spherical harmonics, the tiles an ellipse reaches. 16 Gaussians at a time.
//
//     Σ' = J W R S Sᵀ Rᵀ Wᵀ Jᵀ + 0.3 px² I        det Σ = (fx fy / z²)² Σ_k (s_i s_j)² ((x/z, y/z, 1) · W r_k)²
// with r_k the axes of a Gaussian, s their lengths: a sum of squares, so flat and needle-like Gaussians keep all digits.
// Centres go through float64 (once per Gaussian): float32 world coordinates would shift them by up to 1e-3 px.
// As in 3DGS the Jacobian is taken at a point clamped to 0.15 image sizes outside the image, and differentiated as computed.
#pragma once

#include "raster_types.h"
#include "simd.h"

namespace radiant::RADIANT_ISA {

constexpr int kMaxCoefficients = 48;

template <int kFields>
RADIANT_INLINE void load_fields(const float* rows, int64_t first, int lanes, F out[kFields]) {
  alignas(64) float columns[kFields][kLanes];
  const float* from = rows + first * kFields;
  for (int lane = 0; lane < kLanes; ++lane) {
    const float* row = from + (lane < lanes ? lane : lanes - 1) * kFields;
    for (int field = 0; field < kFields; ++field) columns[field][lane] = row[field];
  }
  for (int field = 0; field < kFields; ++field) out[field] = load(columns[field]);
}

// How rows of gradients are written.
enum class Write { replace, add, stream };

template <int kFields>
RADIANT_INLINE void store_fields(float* rows, int64_t first, int lanes, const F in[kFields], Write write) {
  alignas(64) float columns[kFields][kLanes];
  for (int field = 0; field < kFields; ++field) store(columns[field], in[field]);
  float* to = rows + first * kFields;
  if (write == Write::stream && lanes == kLanes) {
    // 16 rows are whole lines of 64 bytes for any number of fields.
    alignas(64) float lines[kFields * kLanes];
    for (int lane = 0; lane < kLanes; ++lane)
      for (int field = 0; field < kFields; ++field) lines[lane * kFields + field] = columns[field][lane];
    for (int line = 0; line < kFields; ++line) stream(to + line * kLanes, load(lines + line * kLanes));
  } else if (write == Write::add) {
    for (int lane = 0; lane < lanes; ++lane)
      for (int field = 0; field < kFields; ++field) to[lane * kFields + field] += columns[field][lane];
  } else {
    for (int lane = 0; lane < lanes; ++lane)
      for (int field = 0; field < kFields; ++field) to[lane * kFields + field] = columns[field][lane];
  }
}

// The part of the projection that both directions need. Lanes that are not `usable` hold harmless numbers.
struct Geometry {
  F ratio_x, ratio_y, inverse_z;            // x/z, y/z, 1/z (z = 1 where out of range)
  F clamped_x, clamped_y;                   // where the Jacobian is taken
  Mask free_x, free_y;                      // the ratio itself is inside the window
  F quat[4], inverse_norm;                  // unit quaternion, 1/|q| (0 for a zero one)
  F rotation[9];                            // of the Gaussian
  F axes[9];                                // W R: axes in the camera, column k = axis k
  F scales[3];
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
  // Two loops without branches over arrays of their own: so gcc makes vectors of them.
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
    // Far outside the image the whole part may be anything near: such a Gaussian is culled or needs no digits.
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
  // Scaled by the largest entry first, so that no square overflows; below 1e-36 the inverse itself would.
  const F scale = 1.0f / select(nonzero, max(largest, broadcast(1e-36f)), broadcast(1.0f));
  for (int k = 0; k < 4; ++k) q[k] = select(nonzero, q[k] * scale, broadcast(k == 0 ? 1.0f : 0.0f));
  const F norm2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
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
      g.axes[3 * row + k] = static_cast<float>(view.rotation[3 * row]) * R[k] + static_cast<float>(view.rotation[3 * row + 1]) * R[3 + k] +
                            static_cast<float>(view.rotation[3 * row + 2]) * R[6 + k];
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
  F log_scale[3];
  load_fields<3>(log_scales, first, lanes, log_scale);
  const F scale_x = fx * g.inverse_z, scale_y = fy * g.inverse_z;
  F largest = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    g.scales[k] = exp(log_scale[k]);
    g.half_x[k] = g.scales[k] * scale_x * (g.axes[k] - g.clamped_x * g.axes[6 + k]);
    g.half_y[k] = g.scales[k] * scale_y * (g.axes[3 + k] - g.clamped_y * g.axes[6 + k]);
    largest = max(largest, max(abs(g.half_x[k]), abs(g.half_y[k])));
    // An infinite scale times 0 is no number, which the maximum above may drop.
    g.usable = g.usable & (g.scales[k] < broadcast(1e30f));
  }
  g.usable = g.usable & (largest < broadcast(kMaxHalfAxisPx));
  for (int k = 0; k < 3; ++k) g.half_x[k] = keep(g.usable, g.half_x[k]), g.half_y[k] = keep(g.usable, g.half_y[k]);
  g.xx = g.half_x[0] * g.half_x[0] + g.half_x[1] * g.half_x[1] + g.half_x[2] * g.half_x[2];
  g.xy = g.half_x[0] * g.half_y[0] + g.half_x[1] * g.half_y[1] + g.half_x[2] * g.half_y[2];
  g.yy = g.half_y[0] * g.half_y[0] + g.half_y[1] * g.half_y[1] + g.half_y[2] * g.half_y[2];
  const F area = scale_x * scale_y;
  g.determinant = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    const F along = g.clamped_x * g.axes[k] + g.clamped_y * g.axes[3 + k] + g.axes[6 + k];
    const F minor = g.scales[(k + 1) % 3] * (g.scales[(k + 2) % 3] * area) * along;
    g.determinant += minor * minor;
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

// Unit directions (3) from the camera's centre, and 1/distance.
RADIANT_INLINE F view_directions(const View& view, const float* means, int64_t first, int lanes, F direction[3]) {
  alignas(64) float away[3][kLanes];
  const float* from = means + 3 * first;
  for (int lane = 0; lane < kLanes; ++lane)
    for (int axis = 0; axis < 3; ++axis)
      away[axis][lane] = static_cast<float>(from[3 * (lane < lanes ? lane : lanes - 1) + axis] - view.center[axis]);
  for (int axis = 0; axis < 3; ++axis) direction[axis] = load(away[axis]);
  const F length2 = direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2];
  const F inverse = 1.0f / max(sqrt(length2), broadcast(1e-12f));
  for (int axis = 0; axis < 3; ++axis) direction[axis] *= inverse;
  return inverse;
}

// Y_k and, if wanted, ∂Y_k/∂(x, y, z) for k ≥ 1, as harmonics.py has them (Sloan 2008, appendix A2).
template <int kDegree>
RADIANT_INLINE void basis(const F d[3], F* value, F (*slope)[3]) {
  const F &x = d[0], &y = d[1], &z = d[2];
  const F zero = broadcast(0.0f);
  if constexpr (kDegree >= 1) {
    constexpr float c = 0.4886025119029199f;
    value[0] = -c * y, value[1] = c * z, value[2] = -c * x;
    if (slope) {
      slope[0][0] = zero, slope[0][1] = broadcast(-c), slope[0][2] = zero;
      slope[1][0] = zero, slope[1][1] = zero, slope[1][2] = broadcast(c);
      slope[2][0] = broadcast(-c), slope[2][1] = zero, slope[2][2] = zero;
    }
  }
  if constexpr (kDegree >= 2) {
    constexpr float c0 = 1.0925484305920792f, c2 = 0.31539156525252005f, c4 = 0.5462742152960396f;
    value[3] = c0 * (x * y), value[4] = -c0 * (y * z), value[5] = c2 * (2.0f * z * z - x * x - y * y);
    value[6] = -c0 * (x * z), value[7] = c4 * (x * x - y * y);
    if (slope) {
      slope[3][0] = c0 * y, slope[3][1] = c0 * x, slope[3][2] = zero;
      slope[4][0] = zero, slope[4][1] = -c0 * z, slope[4][2] = -c0 * y;
      slope[5][0] = -2 * c2 * x, slope[5][1] = -2 * c2 * y, slope[5][2] = 4 * c2 * z;
      slope[6][0] = -c0 * z, slope[6][1] = zero, slope[6][2] = -c0 * x;
      slope[7][0] = 2 * c4 * x, slope[7][1] = -2 * c4 * y, slope[7][2] = zero;
    }
  }
  if constexpr (kDegree >= 3) {
    constexpr float c0 = -0.5900435899266435f, c1 = 2.890611442640554f, c2 = -0.4570457994644658f, c3 = 0.3731763325901154f;
    constexpr float c5 = 1.445305721320277f;
    const F xx = x * x, yy = y * y, zz = z * z;
    value[8] = c0 * y * (3.0f * xx - yy), value[9] = c1 * (x * y) * z, value[10] = c2 * y * (4.0f * zz - xx - yy);
    value[11] = c3 * z * (2.0f * zz - 3.0f * xx - 3.0f * yy), value[12] = c2 * x * (4.0f * zz - xx - yy);
    value[13] = c5 * z * (xx - yy), value[14] = c0 * x * (xx - 3.0f * yy);
    if (slope) {
      slope[8][0] = 6 * c0 * (x * y), slope[8][1] = 3 * c0 * (xx - yy), slope[8][2] = zero;
      slope[9][0] = c1 * (y * z), slope[9][1] = c1 * (x * z), slope[9][2] = c1 * (x * y);
      slope[10][0] = -2 * c2 * (x * y), slope[10][1] = c2 * (4.0f * zz - xx - 3.0f * yy), slope[10][2] = 8 * c2 * (y * z);
      slope[11][0] = -6 * c3 * (x * z), slope[11][1] = -6 * c3 * (y * z), slope[11][2] = 3 * c3 * (2.0f * zz - xx - yy);
      slope[12][0] = c2 * (4.0f * zz - 3.0f * xx - yy), slope[12][1] = -2 * c2 * (x * y), slope[12][2] = 8 * c2 * (x * z);
      slope[13][0] = 2 * c5 * (x * z), slope[13][1] = -2 * c5 * (y * z), slope[13][2] = c5 * (xx - yy);
      slope[14][0] = 3 * c0 * (xx - yy), slope[14][1] = -6 * c0 * (x * y), slope[14][2] = zero;
    }
  }
}

constexpr float kSh0 = 0.28209479177387814f;

// Colours (3) along `direction`, and ∂colour/∂direction (3 × 3) if slopes is not null; both 0 where the colour is clamped at 0.
template <int kDegree>
RADIANT_INLINE void shade(const SplatArrays& splats, int64_t first, int lanes, uint32_t wanted, const F direction[3], F color[3], F* slopes) {
  constexpr int kBases = (kDegree + 1) * (kDegree + 1) - 1;
  load_fields<3>(splats.sh0, first, lanes, color);
  for (int c = 0; c < 3; ++c) color[c] = 0.5f + kSh0 * color[c];
  if constexpr (kDegree > 0) {
    alignas(64) float rows[kLanes][kMaxCoefficients];
    const int stride = 3 * splats.num_rest;
    // The coefficients are most of what is read: those of the next group are asked for before these are worked on.
    const char* const next = reinterpret_cast<const char*>(splats.shN + (first + kLanes) * stride);
    if (first + 2 * kLanes <= splats.count)
      for (int64_t byte = 0; byte < static_cast<int64_t>(kLanes * stride * sizeof(float)); byte += 64) __builtin_prefetch(next + byte);
    for (int lane = 0; lane < lanes; ++lane)
      if (wanted >> lane & 1) __builtin_memcpy(rows[lane], splats.shN + (first + lane) * stride, 3 * kBases * sizeof(float));
      else __builtin_memset(rows[lane], 0, sizeof(rows[lane]));
    for (int lane = lanes; lane < kLanes; ++lane) __builtin_memset(rows[lane], 0, sizeof(rows[lane]));
    F value[15], slope[15][3];
    basis<kDegree>(direction, value, slopes ? slope : nullptr);
    F sums[9];
    for (int i = 0; i < 9; ++i) sums[i] = broadcast(0.0f);
#pragma GCC unroll 3
    for (int part = 0; part < (3 * kBases + kLanes - 1) / kLanes; ++part) {
      F column[kLanes];
#pragma GCC unroll 16
      for (int lane = 0; lane < kLanes; ++lane) column[lane] = load(rows[lane] + part * kLanes);
      transpose(column);
#pragma GCC unroll 16
      for (int i = 0; i < kLanes; ++i) {
        const int k = (part * kLanes + i) / 3, c = (part * kLanes + i) % 3;
        if (k >= kBases) continue;
        color[c] += value[k] * column[i];
        if (slopes)
          for (int axis = 0; axis < 3; ++axis) sums[3 * c + axis] += slope[k][axis] * column[i];
      }
    }
    if (slopes)
      for (int i = 0; i < 9; ++i) slopes[i] = keep(broadcast(0.0f) <= color[i / 3], sums[i]);
  } else if (slopes) {
    for (int i = 0; i < 9; ++i) slopes[i] = broadcast(0.0f);
  }
}

RADIANT_INLINE void shade(const View& view, const SplatArrays& splats, int64_t first, int lanes, uint32_t wanted, F color[3], F* slopes) {
  F direction[3];
  view_directions(view, splats.means, first, lanes, direction);
  switch (view.sh_degree) {
    case 0: return shade<0>(splats, first, lanes, wanted, direction, color, slopes);
    case 1: return shade<1>(splats, first, lanes, wanted, direction, color, slopes);
    case 2: return shade<2>(splats, first, lanes, wanted, direction, color, slopes);
    default: return shade<3>(splats, first, lanes, wanted, direction, color, slopes);
  }
}

struct Reach {
  F center_x, center_y;       // px
  F extent_x, extent_y;       // half sides of the box with α ≥ α_min, px
  F limit;                    // largest u² + v²
  F l11, l12, l22, slope;     // slope = l12 / l11
  F top;                      // y (relative) of the rightmost point
};

// Which tiles of one row the ellipse reaches: exact, since ellipse ∩ slab is convex. Pixel centres, not borders, bound a tile.
RADIANT_INLINE void row_span(const View& view, const Reach& r, const F& row, F& first, F& last) {
  const F margin = broadcast(1e-2f);
  const F low = row * static_cast<float>(kTilePx) + 0.5f - r.center_y, high = low + static_cast<float>(kTilePx - 1);
  const F limit = r.limit * 1.0005f + 1e-3f;
  const F y_right = clamp(r.top, low, high), y_left = clamp(-r.top, low, high);
  const F v_right = r.l22 * y_right, v_left = r.l22 * y_left;
  const F left_right = limit - v_right * v_right, left_left = limit - v_left * v_left;
  const F right = r.center_x - r.slope * y_right + sqrt(max(left_right, broadcast(0.0f))) / r.l11 + margin;
  const F left = r.center_x - r.slope * y_left - sqrt(max(left_left, broadcast(0.0f))) / r.l11 - margin;
  const Mask hit = (broadcast(0.0f) <= max(left_right, left_left));
  const F tiles_x = broadcast(static_cast<float>(view.tiles_x));
  // Offsets by one tile keep the truncated numbers positive.
  const F low_tile = clamp((left - (kTilePx - 0.5f)) * (1.0f / kTilePx) + 2.0f, broadcast(1.0f), tiles_x + 2.0f);
  const F high_tile = clamp((right - 0.5f) * (1.0f / kTilePx) + 1.0f, broadcast(0.0f), tiles_x);
  // first = ⌈low⌉, last = ⌊high⌋ + 1
  const F floor_low = as_float(truncated(low_tile));
  first = select(floor_low < low_tile, floor_low, floor_low - 1.0f) - 1.0f;
  first = max(first, broadcast(0.0f));
  last = select(hit, as_float(truncated(high_tile)), broadcast(0.0f));
}

RADIANT_INLINE void list_tiles(const View& view, const Reach& r, uint32_t visible, int64_t first, const Projection& out, SpanList& spans) {
  alignas(64) float low[kLanes], high[kLanes], from[kLanes], to[kLanes];
  const float top_row = static_cast<float>(view.tiles_y - 1);
  const F pixel_low = (r.center_y - r.extent_y - (kTilePx - 0.5f)) * (1.0f / kTilePx);
  const F pixel_high = (r.center_y + r.extent_y - 0.5f) * (1.0f / kTilePx);
  const F low_row = as_float(truncated(clamp(pixel_low + 0.99f, broadcast(0.0f), broadcast(top_row + 1.0f))));
  const F high_row = as_float(truncated(clamp(pixel_high + 1.01f, broadcast(0.0f), broadcast(top_row + 1.0f)))) - 1.0f;
  store(low, low_row);
  store(high, high_row);
  int most = 0;
  int64_t bound = 0;
  for (int lane = 0; lane < kLanes; ++lane) {
    if (!(visible >> lane & 1)) continue;
    const int rows = static_cast<int>(high[lane] - low[lane]) + 1;
    bound += rows > 0 ? rows : 0;
    most = rows > most ? rows : most;
  }
  if (spans.size + bound > spans.capacity) spans.reserve(spans, spans.size + bound);
  // Row after row for all lanes at once; spans stand Gaussian after Gaussian, so each lane writes from its own place.
  Span* place[kLanes];
  Span* next = spans.data + spans.size;
  for (int lane = 0; lane < kLanes; ++lane) {
    place[lane] = next;
    if (visible >> lane & 1) next += static_cast<int>(high[lane] - low[lane]) + 1 > 0 ? static_cast<int>(high[lane] - low[lane]) + 1 : 0;
  }
  uint32_t written[kLanes] = {}, tiles[kLanes] = {};
  for (int row = 0; row < most; ++row) {
    F first_tile, last_tile;
    row_span(view, r, low_row + static_cast<float>(row), first_tile, last_tile);
    store(from, first_tile);
    store(to, last_tile);
    for (uint32_t left = visible; left; left &= left - 1) {
      const int lane = __builtin_ctz(left);
      const int index = static_cast<int>(low[lane]) + row;
      if (index > static_cast<int>(high[lane]) || to[lane] <= from[lane]) continue;
      const uint32_t count = static_cast<uint32_t>(to[lane] - from[lane]);
      place[lane][written[lane]++] = {static_cast<uint32_t>(index * view.tiles_x) + static_cast<uint32_t>(from[lane]), count};
      tiles[lane] += count;
    }
  }
  // Close the gaps that rows without a tile have left.
  next = spans.data + spans.size;
  for (int lane = 0; lane < kLanes; ++lane) {
    for (uint32_t i = 0; i < written[lane]; ++i) *next++ = place[lane][i];
    if (!(visible >> lane & 1)) continue;
    out.num_spans[first + lane] = static_cast<uint16_t>(written[lane]);
    out.num_tiles[first + lane] = tiles[lane];
  }
  spans.size = next - spans.data;
}

// Whitening L, extents and opacity of the lanes; returns which lanes are visible.
RADIANT_INLINE Mask reach_of(const View& view, const SplatArrays& splats, int64_t first, int lanes, const Geometry& g, Reach& r, F& log2_opacity) {
  F logit, opacity, rest;
  load_fields<1>(splats.logit_opacities, first, lanes, &logit);
  sigmoids(logit, opacity, rest);
  if (view.antialiased) opacity *= compensation(g);
  log2_opacity = log2(max(opacity, broadcast(1e-30f)));
  r.limit = max(log2_opacity + 7.994353436858858f, broadcast(0.0f));  // − log₂ α_min
  const F root_det = sqrt(g.dilated_determinant), root_yy = sqrt(g.dilated_yy);
  const float s = 0.84932180f;  // √(½ log₂e)
  r.l11 = s * root_yy / root_det;
  r.l12 = -s * (g.xy / root_yy) / root_det;
  r.l22 = s / root_yy;
  r.slope = -(g.xy / g.dilated_yy);
  const F reach = sqrt(r.limit) * (1.0f / s);
  r.extent_x = reach * sqrt(g.dilated_xx);
  r.extent_y = reach * root_yy;
  r.top = reach * g.xy / sqrt(g.dilated_xx);
  r.center_x = load(g.whole_x) + load(g.rest_x);
  r.center_y = load(g.whole_y) + load(g.rest_y);
  const F zero = broadcast(0.0f);
  return g.usable & (zero < r.extent_x) & (zero < r.extent_y) & (zero < r.center_x + r.extent_x) & (zero < r.center_y + r.extent_y) &
         (r.center_x - r.extent_x < broadcast(static_cast<float>(view.width))) &
         (r.center_y - r.extent_y < broadcast(static_cast<float>(view.height)));
}

RADIANT_INLINE void write_footprints(const Geometry& g, const Reach& r, const F& log2_opacity, const F color[3], int64_t first, uint32_t visible,
                                     const Projection& out) {
  F rows[kLanes] = {load(g.whole_x), load(g.whole_y), load(g.rest_x), load(g.rest_y), r.l11, r.l12, r.l22, log2_opacity,
                    color[0], color[1], color[2], load(g.depth), r.slope, r.l11 * r.l12 / (r.l12 * r.l12 + r.l22 * r.l22), load(g.depth_rest),
                    broadcast(0.0f)};
  transpose(rows);
  for (uint32_t left = visible; left; left &= left - 1) {
    const int lane = __builtin_ctz(left);
    store(reinterpret_cast<float*>(out.footprints + first + lane), rows[lane]);
  }
}

static void project(const View& view, const SplatArrays& splats, int64_t begin, int64_t end, const Projection& out, SpanList& spans) {
  for (int64_t first = begin; first < end; first += kLanes) {
    const int lanes = end - first < kLanes ? static_cast<int>(end - first) : kLanes;
    Geometry g;
    Reach r;
    F log2_opacity;
    project_geometry(view, splats, first, lanes, g);
    const uint32_t visible = bits_of(reach_of(view, splats, first, lanes, g, r, log2_opacity));
    alignas(64) float radii[kLanes];
    store(radii, keep(mask_of(visible), max(r.extent_x, r.extent_y)));
    __builtin_memcpy(out.radii_px + first, radii, lanes * sizeof(float));
    __builtin_memcpy(out.means2d + 2 * first, g.means2d, 2 * lanes * sizeof(float));
    __builtin_memset(out.num_spans + first, 0, lanes * sizeof(uint16_t));
    __builtin_memset(out.num_tiles + first, 0, lanes * sizeof(uint32_t));
    if (!visible) continue;
    list_tiles(view, r, visible, first, out, spans);
    F color[3], slopes[9];
    shade(view, splats, first, lanes, visible, color, out.color_slopes ? slopes : nullptr);
    for (int c = 0; c < 3; ++c) color[c] = keep(broadcast(0.0f) <= color[c], max(color[c], broadcast(1e-30f)));
    if (out.color_slopes)
      for (int i = 0; i < 9; ++i) store(out.color_slopes + (first / kLanes * 9 + i) * kLanes, slopes[i]);
    write_footprints(g, r, log2_opacity, color, first, visible, out);
    for (int lane = 0; lane < lanes; ++lane) __builtin_memcpy(out.depth_keys + first + lane, &g.depth[lane], sizeof(float));
  }
}

}  // namespace radiant::RADIANT_ISA
