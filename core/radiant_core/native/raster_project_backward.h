// Gradients of the footprints to gradients of the Gaussians. 16 Gaussians at a time; the geometry is computed again, not stored.
//
//     ∂ln α/∂m = L̂ᵀ (û, v̂)      ∂ln α/∂Σ' = ½ L̂ᵀ (û, v̂)(û, v̂)ᵀ L̂      with (û, v̂) = L̂ (p − m) and L̂ᵀL̂ = Σ'⁻¹
// so of the pixels only the sums of h, hû, hv̂, hû², hûv̂, hv̂² are needed, which `blend_backward` gives.
#pragma once

#include "raster_project.h"

namespace radiant::RADIANT_ISA {

// ∂loss by the quantities of the image plane, per lane.
struct PlaneGradients {
  F mean_x, mean_y, xx, xy, yy, log_opacity, depth, color[3];
};

struct PointGradients {
  F ratio_x, ratio_y, z, mean[3];
};

RADIANT_INLINE void load_moments(const Moments* sums, int64_t first, int lanes, F out[kMoments]) {
  load_fields<kMoments>(reinterpret_cast<const float*>(sums), first, lanes, out);
}

// L scaled to natural logarithms: û = u / √(½ log₂e).
RADIANT_INLINE PlaneGradients plane_gradients(const View& view, const Geometry& g, const F m[kMoments], const float* means2d_gradient,
                                              int64_t first, int lanes) {
  constexpr float s = 0.84932180f;
  const F root_det = sqrt(g.dilated_determinant), root_yy = sqrt(g.dilated_yy);
  const F l11 = root_yy / root_det, l12 = -(g.xy / root_yy) / root_det, l22 = 1.0f / root_yy;
  const F uu = m[3] * (1.0f / (s * s)), uv = m[4] * (1.0f / (s * s)), vv = m[5] * (1.0f / (s * s));
  PlaneGradients p;
  F means[2];
  load_fields<2>(means2d_gradient, first, lanes, means);
  p.mean_x = means[0], p.mean_y = means[1];
  p.xx = 0.5f * (l11 * l11 * uu);
  p.xy = l11 * (l12 * uu + l22 * uv);
  p.yy = 0.5f * (l12 * (l12 * uu + 2.0f * l22 * uv) + l22 * l22 * vv);
  p.log_opacity = m[0];
  for (int c = 0; c < 3; ++c) p.color[c] = m[6 + c];
  p.depth = m[9];
  return p;
}

// ln compensation = ½ (ln det Σ − ln det Σ'), constant under its floor, with det Σ' = det Σ + s tr Σ + s². What hangs on tr Σ joins the
// covariance's gradient; ∂loss/∂ln det Σ is returned and goes through the sum of squares that det Σ is: as a gradient of xx, xy and yy
// it would cancel along a needle.
RADIANT_INLINE F compensation_backward(const Geometry& g, PlaneGradients& p) {
  constexpr float s = kDilationPx2;
  const Mask above = broadcast(1e-12f) < g.determinant / g.dilated_determinant;
  const F factor = keep(above, 0.5f * s * p.log_opacity) / g.dilated_determinant;
  p.xx -= factor;
  p.yy -= factor;
  return factor * (g.xx + g.yy + s);
}

// ∂loss/∂ln det Σ to the lengths and axes, and to where the Jacobian is taken. det Σ = Σ_k minor_k², as in `project_covariance`.
RADIANT_INLINE void determinant_backward(const Geometry& g, const F& area, const F& log_determinant, F log_scales[3], F axes[9], F& clamped_x, F& clamped_y) {
  F over_along[3], squares[3];
  const F factor = 2.0f * log_determinant / select(broadcast(0.0f) < g.determinant, g.determinant, broadcast(1.0f));
  for (int k = 0; k < 3; ++k) {
    const F along = g.clamped_x * g.axes[k] + g.clamped_y * g.axes[3 + k] + g.axes[6 + k];
    const F size = g.scales[(k + 1) % 3] * (g.scales[(k + 2) % 3] * area), minor = size * along;
    squares[k] = factor * minor * minor;
    over_along[k] = factor * minor * size;
  }
  for (int k = 0; k < 3; ++k) {
    log_scales[k] += squares[(k + 1) % 3] + squares[(k + 2) % 3];
    axes[k] += g.clamped_x * over_along[k];
    axes[3 + k] += g.clamped_y * over_along[k];
    axes[6 + k] += over_along[k];
    clamped_x += g.axes[k] * over_along[k];
    clamped_y += g.axes[3 + k] * over_along[k];
  }
}

// Through the covariance to the lengths and axes of the Gaussian and to where it stands.
RADIANT_INLINE void covariance_backward(const View& view, const Geometry& g, PlaneGradients& p, F log_scales[3], F axes[9], PointGradients& at) {
  const F log_determinant = view.antialiased ? compensation_backward(g, p) : broadcast(0.0f);
  const F scale_x = static_cast<float>(view.fx) * g.inverse_z, scale_y = static_cast<float>(view.fy) * g.inverse_z;
  F clamped_x = broadcast(0.0f), clamped_y = broadcast(0.0f);
  for (int k = 0; k < 3; ++k) {
    const F half_x = 2.0f * p.xx * g.half_x[k] + p.xy * g.half_y[k], half_y = 2.0f * p.yy * g.half_y[k] + p.xy * g.half_x[k];
    log_scales[k] = half_x * g.half_x[k] + half_y * g.half_y[k];
    axes[k] = half_x * g.scales[k] * scale_x;
    axes[3 + k] = half_y * g.scales[k] * scale_y;
    axes[6 + k] = -(g.clamped_x * axes[k] + g.clamped_y * axes[3 + k]);
    clamped_x -= axes[k] * g.axes[6 + k];
    clamped_y -= axes[3 + k] * g.axes[6 + k];
  }
  if (view.antialiased) determinant_backward(g, scale_x * scale_y, log_determinant, log_scales, axes, clamped_x, clamped_y);
  at.ratio_x = static_cast<float>(view.fx) * p.mean_x + keep(g.free_x, clamped_x);
  at.ratio_y = static_cast<float>(view.fy) * p.mean_y + keep(g.free_y, clamped_y);
  // Each half axis is a length over the depth.
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

// Writes ∂loss/∂sh0, ∂loss/∂shN = Y_k ∂loss/∂colour of the lanes.
template <int kDegree>
RADIANT_INLINE void harmonics_backward(const SplatArrays& splats, int64_t first, int lanes, const F direction[3], const F color[3],
                                       const SplatGradients& out, Write write) {
  constexpr int kBases = (kDegree + 1) * (kDegree + 1) - 1;
  if (out.sh0) {
    const F sh0[3] = {kSh0 * color[0], kSh0 * color[1], kSh0 * color[2]};
    store_fields<3>(out.sh0, first, lanes, sh0, write);
  }
  if (!out.shN || splats.num_rest == 0) return;
  const int stride = 3 * splats.num_rest;
  // Rows one after another; the last vector of a row reaches into the next, which is written later, hence parts from last to first.
  constexpr int kParts = (3 * kBases + kLanes - 1) / kLanes;
  alignas(64) float rows[kLanes * 3 * kBases + kLanes];
  if constexpr (kDegree > 0) {
    F value[15];
    basis<kDegree>(direction, value, nullptr);
    for (int part = kParts - 1; part >= 0; --part) {
      F column[kLanes];
      for (int i = 0; i < kLanes; ++i) {
        const int k = (part * kLanes + i) / 3, c = (part * kLanes + i) % 3;
        column[i] = k < kBases ? value[k] * color[c] : broadcast(0.0f);
      }
      transpose(column);
      for (int lane = 0; lane < kLanes; ++lane) store(rows + lane * 3 * kBases + part * kLanes, column[lane]);
    }
  }
  if (write == Write::stream && lanes == kLanes && stride == 3 * kBases) {
    for (int line = 0; line < 3 * kBases; ++line) stream(out.shN + first * stride + line * kLanes, load(rows + line * kLanes));
    return;
  }
  for (int lane = 0; lane < lanes; ++lane) {
    float* to = out.shN + (first + lane) * stride;
    if (write == Write::add) {
      for (int i = 0; i < 3 * kBases; ++i) to[i] += rows[lane * 3 * kBases + i];
    } else {
      __builtin_memcpy(to, rows + lane * 3 * kBases, 3 * kBases * sizeof(float));
      __builtin_memset(to + 3 * kBases, 0, (stride - 3 * kBases) * sizeof(float));
    }
  }
}

RADIANT_INLINE void harmonics_backward(const View& view, const SplatArrays& splats, int64_t first, int lanes, const F direction[3],
                                       const F color[3], const SplatGradients& out, Write write) {
  switch (view.sh_degree) {
    case 0: return harmonics_backward<0>(splats, first, lanes, direction, color, out, write);
    case 1: return harmonics_backward<1>(splats, first, lanes, direction, color, out, write);
    case 2: return harmonics_backward<2>(splats, first, lanes, direction, color, out, write);
    default: return harmonics_backward<3>(splats, first, lanes, direction, color, out, write);
  }
}

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
    PlaneGradients p = plane_gradients(view, g, m, means2d_gradient, first, lanes);

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
