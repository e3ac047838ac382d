// Gaussians to footprints: what blending needs, and the tiles reached. 16 Gaussians at a time.
#pragma once

#include "raster/color.h"
#include "raster/geometry.h"

namespace radiant::RADIANT_ISA {

struct Reach {
  F center_x, center_y;       // px
  F extent_x, extent_y;       // half sides of the box with α ≥ α_min, px
  F limit;                    // largest u² + v²
  F l11, l12, l22, slope;     // slope = l12 / l11
  F inverse_l11;
  F top;                      // y (relative) of the rightmost point
};

// Which tiles of one row the ellipse reaches: exact, since ellipse ∩ slab is convex. Pixel centres,
// not borders, bound a tile.
RADIANT_INLINE void row_span(const View& view, const Reach& r, const F& row, F& first, F& last) {
  const F margin = broadcast(1e-2f);
  const F low = row * static_cast<float>(kTilePx) + 0.5f - r.center_y, high = low + static_cast<float>(kTilePx - 1);
  const F limit = r.limit * 1.0005f + 1e-3f;
  const F y_right = clamp(r.top, low, high), y_left = clamp(-r.top, low, high);
  const F v_right = r.l22 * y_right, v_left = r.l22 * y_left;
  const F left_right = limit - v_right * v_right, left_left = limit - v_left * v_left;
  const F right = r.center_x - r.slope * y_right + sqrt(max(left_right, broadcast(0.0f))) * r.inverse_l11 + margin;
  const F left = r.center_x - r.slope * y_left - sqrt(max(left_left, broadcast(0.0f))) * r.inverse_l11 - margin;
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
  // Row after row for all lanes at once; spans stand Gaussian after Gaussian, so each lane writes
  // from its own place.
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
  const F inverse_yy = 1.0f / root_yy, inverse_det = 1.0f / root_det, along = g.xy * inverse_yy;
  r.l11 = s * root_yy * inverse_det;
  r.l12 = -s * along * inverse_det;
  r.l22 = s * inverse_yy;
  r.slope = -(along * inverse_yy);
  r.inverse_l11 = (1.0f / s) * root_det * inverse_yy;
  const F reach = sqrt(r.limit) * (1.0f / s);
  const F root_xx = sqrt(g.dilated_xx);
  r.extent_x = reach * root_xx;
  r.extent_y = reach * root_yy;
  r.top = reach * g.xy / root_xx;
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

// How far a Gaussian reaches along one side of the image at most, in px per length / depth.
RADIANT_INLINE float widest_reach(double focal, double middle, int side) {
  const double margin = 0.15 * side, low = (middle + margin) / focal, high = (side - middle + margin) / focal;
  const double steepest2 = low * low < high * high ? high * high : low * low;
  // √(−log₂ α_min ÷ ½ log₂e) = 3.33 standard deviations.
  return static_cast<float>(3.4 * focal * __builtin_sqrt(1 + steepest2));
}

// Which lanes may be visible, by centre and longest axis alone. Margins are far above rounding:
// what is left out here is not visible below. A view of a large scene sees a tenth of it.
RADIANT_INLINE Mask near_image(const View& view, const float reach[2], const SplatArrays& splats, int64_t first, int lanes, const Geometry& g) {
  F log_scales[3];
  load_fields<3>(splats.log_scales, first, lanes, log_scales);
  const F zero = broadcast(0.0f), far = broadcast(1e7f);
  const F size = min(exp(max(max(log_scales[0], log_scales[1]), log_scales[2])) * g.inverse_z, broadcast(1e9f));
  const F x = clamp(load(g.whole_x) + load(g.rest_x), -far, far), y = clamp(load(g.whole_y) + load(g.rest_y), -far, far);
  // 3 px: 3.4 · √0.3 of dilation and one more.
  const F around_x = size * reach[0] + 3.0f + 1e-4f * abs(x), around_y = size * reach[1] + 3.0f + 1e-4f * abs(y);
  return g.usable & (zero < x + around_x) & (zero < y + around_y) & (x - around_x < broadcast(static_cast<float>(view.width))) &
         (y - around_y < broadcast(static_cast<float>(view.height)));
}

static void project(const View& view, const SplatArrays& splats, int64_t begin, int64_t end, const Projection& out, SpanList& spans) {
  const float reach[2] = {widest_reach(view.fx, view.cx, view.width), widest_reach(view.fy, view.cy, view.height)};
  for (int64_t first = begin; first < end; first += kLanes) {
    const int lanes = end - first < kLanes ? static_cast<int>(end - first) : kLanes;
    Geometry g;
    Reach r;
    F log2_opacity;
    uint32_t visible = 0;
    alignas(64) float radii[kLanes] = {};
    project_centers(view, splats.means, first, lanes, g);
    if (bits_of(near_image(view, reach, splats, first, lanes, g))) {
      rotate(view, splats.quats, first, lanes, g);
      project_covariance(view, splats.log_scales, first, lanes, g);
      visible = bits_of(reach_of(view, splats, first, lanes, g, r, log2_opacity));
      store(radii, keep(mask_of(visible), max(r.extent_x, r.extent_y)));
    }
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
