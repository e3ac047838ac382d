// Colours along the line of sight from spherical harmonics (as in harmonics.py), and back.
#pragma once

#include "machine/simd_rows.h"
#include "raster/types.h"

namespace radiant::RADIANT_ISA {

constexpr int kMaxCoefficients = 48;

// Unit directions (3) from the camera's centre, and 1/distance.
RADIANT_INLINE F view_directions(const View& view, const float* means, int64_t first, int lanes, F direction[3]) {
  alignas(64) float away[3][kLanes];
  const float* from = means + 3 * first;
  for (int lane = 0; lane < kLanes; ++lane)
    for (int axis = 0; axis < 3; ++axis)
      away[axis][lane] = static_cast<float>(from[3 * (lane < lanes ? lane : lanes - 1) + axis] - view.center[axis]);
  for (int axis = 0; axis < 3; ++axis) direction[axis] = load(away[axis]);
  const F length2 = dot(direction[0], direction[0], direction[1], direction[1], direction[2], direction[2]);
  const F inverse = 1.0f / max(sqrt(length2), broadcast(1e-12f));
  for (int axis = 0; axis < 3; ++axis) direction[axis] *= inverse;
  return inverse;
}

// Y_k and, if wanted, ∂Y_k/∂(x, y, z) for k ≥ 1, as in harmonics.py (Sloan 2008, appendix A2).
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

// Colours (3) along `direction`, and ∂colour/∂direction (3 × 3) if slopes is not null; both 0 where
// the colour is clamped at 0.
template <int kDegree>
RADIANT_INLINE void shade(const SplatArrays& splats, int64_t first, int lanes, uint32_t wanted, const F direction[3], F color[3], F* slopes) {
  constexpr int kBases = (kDegree + 1) * (kDegree + 1) - 1;
  load_fields<3>(splats.sh0, first, lanes, color);
  for (int c = 0; c < 3; ++c) color[c] = 0.5f + kSh0 * color[c];
  if constexpr (kDegree > 0) {
    alignas(64) float rows[kLanes][kMaxCoefficients];
    const int stride = 3 * splats.num_rest;
    // Coefficients are most of what is read: the next group's are prefetched before these are used.
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
        color[c] = fma(value[k], column[i], color[c]);
        if (slopes)
          for (int axis = 0; axis < 3; ++axis) sums[3 * c + axis] = fma(slope[k][axis], column[i], sums[3 * c + axis]);
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
  // Rows one after another; the last vector of a row reaches into the next, which is written later,
  // hence parts from last to first.
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

}  // namespace radiant::RADIANT_ISA
