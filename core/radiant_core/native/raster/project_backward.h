// Gradients of footprints to gradients of Gaussians, 16 at a time; the geometry is computed again.
//
//     ∂ln α/∂m = L̂ᵀ (û, v̂)      ∂ln α/∂Σ' = ½ L̂ᵀ (û, v̂)(û, v̂)ᵀ L̂
// with (û, v̂) = L̂ (p − m), L̂ᵀL̂ = Σ'⁻¹: sums of h, hû, hv̂, hû², hûv̂, hv̂² over pixels suffice.
#pragma once

#include "raster/project.h"

namespace radiant::RADIANT_ISA {

// ∂loss by the quantities of the image plane, per lane; L̂ and the sums of hû², hûv̂, hv̂².
struct PlaneGradients {
  F mean_x, mean_y, l11, l12, l22, uu, uv, vv, log_opacity, depth, color[3];
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

// s_i/s_j − s_j/s_i = 2 sinh(ln s_i − ln s_j), with all digits for nearly equal lengths too.
RADIANT_INLINE F ratio_difference(const Geometry& g, int i, int j) {
  const F d = g.log_scales[i] - g.log_scales[j], d2 = d * d;
  const F near = d * (2.0f + d2 * (1.0f / 3 + d2 * (1.0f / 60 + d2 * (1.0f / 2520))));
  const F far = clamp(g.scales[i] / g.scales[j] - g.scales[j] / g.scales[i], broadcast(-1e37f), broadcast(1e37f));
  return select(d2 < broadcast(0.25f), near, far);
}

// ∂loss by the lengths, by turns about the axes over `ratio_difference`, by the Jacobian's place.
struct ShapeGradients {
  F log_scales[3], turns[3], clamped_x, clamped_y;
};

// ∂loss/∂ln opacity through ln √(det Σ / det Σ'), constant under the floor of `compensation`. With
// det Σ' = det Σ + s tr Σ + s², tr Σ = Σ_k |half_k|² and det Σ = Σ_k minor_k² a needle's gradient
// is a sum of small things, where a gradient of xx, xy and yy would cancel.
RADIANT_INLINE void compensation_backward(const Geometry& g, const F& scale_x, const F& scale_y, const F& log_opacity, ShapeGradients& out) {
  constexpr float s = kDilationPx2;
  const Mask above = broadcast(1e-12f) < g.determinant / g.dilated_determinant;
  const F by_trace = keep(above, s * log_opacity) / g.dilated_determinant;
  const F trace = g.xx + g.yy, by_share = by_trace * (trace + s), inverse_det = 1.0f / select(above, g.determinant, broadcast(1.0f));
  F minor[3], share[3], length2[3];
  for (int k = 0; k < 3; ++k) {
    const F along = g.clamped_x * g.axes[k] + g.clamped_y * g.axes[3 + k] + g.axes[6 + k];
    const F size = g.scales[(k + 1) % 3] * (g.scales[(k + 2) % 3] * (scale_x * scale_y));
    minor[k] = size * along;
    const F over_det = minor[k] * inverse_det, by_along = by_share * (over_det * size), z = by_trace * g.scales[k] * g.axes[6 + k];
    share[k] = over_det * minor[k];
    length2[k] = g.half_x[k] * g.half_x[k] + g.half_y[k] * g.half_y[k];
    out.clamped_x += by_along * g.axes[k] + g.half_x[k] * scale_x * z;
    out.clamped_y += by_along * g.axes[3 + k] + g.half_y[k] * scale_y * z;
  }
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    out.log_scales[k] += by_trace * (s * (share[i] + share[j]) + (length2[i] + length2[j]) - trace * share[k]);
    out.turns[k] -= by_trace * (g.half_x[i] * g.half_x[j] + g.half_y[i] * g.half_y[j]) + by_share * (minor[i] * inverse_det * minor[j]);
  }
}

// Through the covariance. With a_k = L̂ half_k, of length 1 or less, M the sums of (û, v̂)(û, v̂)ᵀ:
//     ∂/∂ln s_k = a_kᵀ M a_k        ∂/∂turn_k = 2 sinh(ln s_i − ln s_j) a_iᵀ M a_j
// As a difference of two gradients of axes the second would cancel for round Gaussians.
RADIANT_INLINE ShapeGradients covariance_backward(const View& view, const Geometry& g, const PlaneGradients& p) {
  const F scale_x = static_cast<float>(view.fx) * g.inverse_z, scale_y = static_cast<float>(view.fy) * g.inverse_z;
  ShapeGradients out;
  F u[3], v[3], by_u[3], by_v[3];
  out.clamped_x = out.clamped_y = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    u[k] = p.l11 * g.half_x[k] + p.l12 * g.half_y[k], v[k] = p.l22 * g.half_y[k];
    by_u[k] = p.uu * u[k] + p.uv * v[k], by_v[k] = p.uv * u[k] + p.vv * v[k];
    out.log_scales[k] = u[k] * by_u[k] + v[k] * by_v[k];
    const F z = g.scales[k] * g.axes[6 + k];
    out.clamped_x -= p.l11 * by_u[k] * scale_x * z;
    out.clamped_y -= (p.l12 * by_u[k] + p.l22 * by_v[k]) * scale_y * z;
  }
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    out.turns[k] = u[i] * by_u[j] + v[i] * by_v[j];
  }
  if (view.antialiased) compensation_backward(g, scale_x, scale_y, p.log_opacity, out);
  return out;
}

// Through the camera to the means; every half axis is a length over the depth.
RADIANT_INLINE void center_backward(const View& view, const Geometry& g, const PlaneGradients& p, const ShapeGradients& shape, F means[3]) {
  const F x = (static_cast<float>(view.fx) * p.mean_x + keep(g.free_x, shape.clamped_x)) * g.inverse_z;
  const F y = (static_cast<float>(view.fy) * p.mean_y + keep(g.free_y, shape.clamped_y)) * g.inverse_z;
  const F z = p.depth - (shape.log_scales[0] + shape.log_scales[1] + shape.log_scales[2]) * g.inverse_z - (x * g.ratio_x + y * g.ratio_y);
  for (int axis = 0; axis < 3; ++axis)
    means[axis] = static_cast<float>(view.rotation[axis]) * x + static_cast<float>(view.rotation[3 + axis]) * y +
                  static_cast<float>(view.rotation[6 + axis]) * z;
}

// A turn by t about axis k is q (1, ½ t e_k), and the three q e_k are orthonormal.
RADIANT_INLINE void rotation_backward(const Geometry& g, const F turns[3], F quats[4]) {
  F t[3];
  for (int k = 0; k < 3; ++k) t[k] = 2.0f * g.inverse_norm * (turns[k] * ratio_difference(g, (k + 1) % 3, (k + 2) % 3));
  const F &w = g.quat[0], &x = g.quat[1], &y = g.quat[2], &z = g.quat[3];
  quats[0] = -(x * t[0] + y * t[1] + z * t[2]);
  quats[1] = w * t[0] - z * t[1] + y * t[2];
  quats[2] = z * t[0] + w * t[1] - x * t[2];
  quats[3] = x * t[1] - y * t[0] + w * t[2];
}

// A gradient beyond float32 (a quaternion of length 1e-36, say) is held at the largest number, inf
// in the reference. NaN stays: min and max return their second argument.
RADIANT_INLINE F finite(Mask visible, const F& a) { return keep(visible, max(broadcast(-1e37f), min(broadcast(1e37f), a))); }

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
    const ShapeGradients shape = covariance_backward(view, g, p);
    F means[3], log_scales[3], quats[4];
    center_backward(view, g, p, shape, means);
    rotation_backward(g, shape.turns, quats);
    for (int axis = 0; axis < 3; ++axis)
      away[axis] = p.color[0] * slopes[axis] + p.color[1] * slopes[3 + axis] + p.color[2] * slopes[6 + axis];
    const F radial = away[0] * direction[0] + away[1] * direction[1] + away[2] * direction[2];
    for (int axis = 0; axis < 3; ++axis)
      means[axis] = finite(moved, means[axis] + keep(drawn, (away[axis] - direction[axis] * radial) * inverse_distance));
    for (int k = 0; k < 3; ++k) log_scales[k] = finite(drawn, shape.log_scales[k]);
    for (int k = 0; k < 4; ++k) quats[k] = finite(drawn, quats[k]);
    if (out.means) store_fields<3>(out.means, first, lanes, means, write);
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
