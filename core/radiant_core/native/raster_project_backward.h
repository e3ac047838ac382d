// Gradients of the footprints to gradients of the Gaussians. 16 Gaussians at a time; the geometry is computed again, not stored.
//
//     ∂ln α/∂m = L̂ᵀ (û, v̂)      ∂ln α/∂Σ' = ½ L̂ᵀ (û, v̂)(û, v̂)ᵀ L̂      with (û, v̂) = L̂ (p − m) and L̂ᵀL̂ = Σ'⁻¹
// so of the pixels only the sums of h, hû, hv̂, hû², hûv̂, hv̂² are needed, which `blend_backward` gives.
#pragma once

#include "raster_project.h"

namespace radiant::RADIANT_ISA {

// ∂loss by the quantities of the image plane, per lane; L̂ and the sums of hû², hûv̂, hv̂².
struct PlaneGradients {
  F mean_x, mean_y, l11, l12, l22, uu, uv, vv, log_opacity, depth, color[3];
};

struct PointGradients {
  F ratio_x, ratio_y, z, mean[3];
};

RADIANT_INLINE void load_moments(const Moments* sums, int64_t first, int lanes, F out[kMoments]) {
  load_fields<kMoments>(reinterpret_cast<const float*>(sums), first, lanes, out);
}

// L scaled to natural logarithms: û = u / √(½ log₂e).
RADIANT_INLINE PlaneGradients plane_gradients(const Geometry& g, const F m[kMoments], const float* means2d_gradient, int64_t first, int lanes) {
  const F root_det = sqrt(g.dilated_determinant), root_yy = sqrt(g.dilated_yy);
  PlaneGradients p;
  F means[2];
  load_fields<2>(means2d_gradient, first, lanes, means);
  p.mean_x = means[0], p.mean_y = means[1];
  p.l11 = root_yy / root_det, p.l12 = -(g.xy / root_yy) / root_det, p.l22 = 1.0f / root_yy;
  p.uu = m[3] * (1.0f / kHalfLog2e), p.uv = m[4] * (1.0f / kHalfLog2e), p.vv = m[5] * (1.0f / kHalfLog2e);
  p.log_opacity = m[0];
  for (int c = 0; c < 3; ++c) p.color[c] = m[6 + c];
  p.depth = m[9];
  return p;
}

// ∂loss/∂ln opacity through ln √(det Σ / det Σ') to lengths, axes and the Jacobian; constant under the floor of `compensation`.
// With det Σ' = det Σ + s tr Σ + s², tr Σ = Σ_k |half_k|² and det Σ = Σ_k minor_k² a needle's gradient is a sum of small things, where a
// gradient of xx, xy and yy would cancel.
RADIANT_INLINE void compensation_backward(const Geometry& g, const F& scale_x, const F& scale_y, const F& log_opacity, F log_scales[3], F axes[9],
                                          F& clamped_x, F& clamped_y) {
  constexpr float s = kDilationPx2;
  const Mask above = broadcast(1e-12f) < g.determinant / g.dilated_determinant;
  const F by_trace = keep(above, s * log_opacity) / g.dilated_determinant;
  const F trace = g.xx + g.yy, by_share = by_trace * (trace + s), inverse_det = 1.0f / select(above, g.determinant, broadcast(1.0f));
  F share[3], length2[3];
  for (int k = 0; k < 3; ++k) {
    const F along = g.clamped_x * g.axes[k] + g.clamped_y * g.axes[3 + k] + g.axes[6 + k];
    const F size = g.scales[(k + 1) % 3] * (g.scales[(k + 2) % 3] * (scale_x * scale_y)), over_det = size * along * inverse_det;
    share[k] = over_det * (size * along);
    length2[k] = g.half_x[k] * g.half_x[k] + g.half_y[k] * g.half_y[k];
    const F by_along = by_share * (over_det * size), x = by_trace * g.half_x[k] * g.scales[k] * scale_x, y = by_trace * g.half_y[k] * g.scales[k] * scale_y;
    axes[k] += by_along * g.clamped_x - x;
    axes[3 + k] += by_along * g.clamped_y - y;
    axes[6 + k] += by_along + (g.clamped_x * x + g.clamped_y * y);
    clamped_x += by_along * g.axes[k] + x * g.axes[6 + k];
    clamped_y += by_along * g.axes[3 + k] + y * g.axes[6 + k];
  }
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    log_scales[k] += by_trace * (s * (share[i] + share[j]) + (length2[i] + length2[j]) - trace * share[k]);
  }
}

// Through the covariance to the lengths and axes of the Gaussian and to where it stands. A half axis h gets L̂ᵀ M L̂ h: whitened first, so
// that it is of length 1 or less, along a needle too.
RADIANT_INLINE void covariance_backward(const View& view, const Geometry& g, const PlaneGradients& p, F log_scales[3], F axes[9], PointGradients& at) {
  const F scale_x = static_cast<float>(view.fx) * g.inverse_z, scale_y = static_cast<float>(view.fy) * g.inverse_z;
  F clamped_x = broadcast(0.0f), clamped_y = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    const F u = p.l11 * g.half_x[k] + p.l12 * g.half_y[k], v = p.l22 * g.half_y[k];
    const F by_u = p.uu * u + p.uv * v, by_v = p.uv * u + p.vv * v;
    log_scales[k] = u * by_u + v * by_v;
    axes[k] = p.l11 * by_u * g.scales[k] * scale_x;
    axes[3 + k] = (p.l12 * by_u + p.l22 * by_v) * g.scales[k] * scale_y;
    axes[6 + k] = -(g.clamped_x * axes[k] + g.clamped_y * axes[3 + k]);
    clamped_x -= axes[k] * g.axes[6 + k];
    clamped_y -= axes[3 + k] * g.axes[6 + k];
  }
  if (view.antialiased) compensation_backward(g, scale_x, scale_y, p.log_opacity, log_scales, axes, clamped_x, clamped_y);
  at.ratio_x = static_cast<float>(view.fx) * p.mean_x + keep(g.free_x, clamped_x);
  at.ratio_y = static_cast<float>(view.fy) * p.mean_y + keep(g.free_y, clamped_y);
  // Every half axis is a length over the depth.
  at.z = p.depth - (log_scales[0] + log_scales[1] + log_scales[2]) * g.inverse_z;
}

RADIANT_INLINE void center_backward(const View& view, const Geometry& g, PointGradients& at) {
  const F x = at.ratio_x * g.inverse_z, y = at.ratio_y * g.inverse_z;
  const F z = at.z - (x * g.ratio_x + y * g.ratio_y);
  for (int axis = 0; axis < 3; ++axis)
    at.mean[axis] = static_cast<float>(view.rotation[axis]) * x + static_cast<float>(view.rotation[3 + axis]) * y +
                    static_cast<float>(view.rotation[6 + axis]) * z;
}

RADIANT_INLINE void rotation_backward(const View& view, const Geometry& g, const F axes[9], F quats[4]) {
  F R[9];
  for (int row = 0; row < 3; ++row)
    for (int k = 0; k < 3; ++k)
      R[3 * row + k] = static_cast<float>(view.rotation[row]) * axes[k] + static_cast<float>(view.rotation[3 + row]) * axes[3 + k] +
                       static_cast<float>(view.rotation[6 + row]) * axes[6 + k];
  const F &w = g.quat[0], &x = g.quat[1], &y = g.quat[2], &z = g.quat[3];
  F q[4] = {
      2.0f * (x * (R[7] - R[5]) + y * (R[2] - R[6]) + z * (R[3] - R[1])),
      2.0f * (y * (R[1] + R[3]) + z * (R[2] + R[6]) + w * (R[7] - R[5]) - 2.0f * x * (R[4] + R[8])),
      2.0f * (x * (R[1] + R[3]) + z * (R[5] + R[7]) + w * (R[2] - R[6]) - 2.0f * y * (R[0] + R[8])),
      2.0f * (x * (R[2] + R[6]) + y * (R[5] + R[7]) + w * (R[3] - R[1]) - 2.0f * z * (R[0] + R[4])),
  };
  const F radial = q[0] * w + q[1] * x + q[2] * y + q[3] * z;
  for (int k = 0; k < 4; ++k) quats[k] = (q[k] - g.quat[k] * radial) * g.inverse_norm;
}

// A gradient that leaves float32 (a quaternion of length 1e-36, say) is held at the largest number, where the reference holds inf.
RADIANT_INLINE F finite(Mask visible, const F& a) { return keep(visible, clamp(a, broadcast(-1e37f), broadcast(1e37f))); }

RADIANT_INLINE void clear(const SplatArrays& splats, int64_t first, int lanes, const SplatGradients& out) {
  if (out.add) return;
  float* const arrays[] = {out.means, out.quats, out.log_scales, out.logit_opacities, out.sh0, out.shN};
  const int widths[] = {3, 4, 3, 1, 3, 3 * splats.num_rest};
  for (int i = 0; i < 6; ++i)
    if (arrays[i]) __builtin_memset(arrays[i] + first * widths[i], 0, static_cast<size_t>(lanes) * widths[i] * sizeof(float));
}

static void project_backward(const View& view, const SplatArrays& splats, int64_t begin, int64_t end, const Projection& projection,
                             const Moments* sums, const float* means2d_gradient, const SplatGradients& out) {
  const Write write = out.add ? Write::add : out.stream ? Write::stream : Write::replace;
  for (int64_t first = begin; first < end; first += kLanes) {
    const int lanes = end - first < kLanes ? static_cast<int>(end - first) : kLanes;
    uint32_t touched = 0;
    for (int lane = 0; lane < lanes; ++lane) {
      const bool moved = means2d_gradient[2 * (first + lane)] != 0.0f || means2d_gradient[2 * (first + lane) + 1] != 0.0f;
      touched |= static_cast<uint32_t>(projection.num_tiles[first + lane] != 0 || moved) << lane;
    }
    if (!touched) {
      clear(splats, first, lanes, out);
      continue;
    }
    Geometry g;
    project_geometry(view, splats, first, lanes, g);
    const Mask moved = mask_of(touched) & (broadcast(0.0f) < g.inverse_z);
    uint32_t drawn_bits = 0;
    for (int lane = 0; lane < lanes; ++lane) drawn_bits |= static_cast<uint32_t>(projection.num_tiles[first + lane] != 0) << lane;
    const Mask drawn = mask_of(drawn_bits);
    F m[kMoments];
    load_moments(sums, first, lanes, m);
    for (int k = 0; k < kMoments; ++k) m[k] = keep(drawn, m[k]);
    const PlaneGradients p = plane_gradients(g, m, means2d_gradient, first, lanes);

    F direction[3], slopes[9], away[3];
    const F inverse_distance = view_directions(view, splats.means, first, lanes, direction);
    for (int i = 0; i < 9; ++i) slopes[i] = keep(drawn, load(projection.color_slopes + (first / kLanes * 9 + i) * kLanes));
    F log_scales[3], axes[9], quats[4];
    PointGradients at;
    covariance_backward(view, g, p, log_scales, axes, at);
    center_backward(view, g, at);
    rotation_backward(view, g, axes, quats);
    for (int axis = 0; axis < 3; ++axis)
      away[axis] = p.color[0] * slopes[axis] + p.color[1] * slopes[3 + axis] + p.color[2] * slopes[6 + axis];
    const F radial = away[0] * direction[0] + away[1] * direction[1] + away[2] * direction[2];
    for (int axis = 0; axis < 3; ++axis)
      at.mean[axis] = finite(moved, at.mean[axis] + keep(drawn, (away[axis] - direction[axis] * radial) * inverse_distance));
    for (int k = 0; k < 3; ++k) log_scales[k] = finite(drawn, log_scales[k]);
    for (int k = 0; k < 4; ++k) quats[k] = finite(drawn, quats[k]);
    if (out.means) store_fields<3>(out.means, first, lanes, at.mean, write);
    if (out.log_scales) store_fields<3>(out.log_scales, first, lanes, log_scales, write);
    if (out.quats) store_fields<4>(out.quats, first, lanes, quats, write);
    if (out.logit_opacities) {
      F logit, positive, negative;
      load_fields<1>(splats.logit_opacities, first, lanes, &logit);
      sigmoids(logit, positive, negative);
      const F gradient = finite(drawn, p.log_opacity * negative);
      store_fields<1>(out.logit_opacities, first, lanes, &gradient, write);
    }
    harmonics_backward(view, splats, first, lanes, direction, p.color, out, write);
  }
  finish_streams();
}

}  // namespace radiant::RADIANT_ISA
