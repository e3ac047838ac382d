// One tile: which blocks each Gaussian reaches, front-to-back blending, and its gradient. One vector = one block of 4 × 4 pixels.
//
//     w_i = α_i T_i,  T_{i+1} = T_i (1 − α_i);   image = Σ w_i c_i + T_end · background             (paper Eqn. 2)
//     ∂loss/∂α_i = T_i (G_i − B_i),  B_{i−1} = B_i + α_i (G_i − B_i),  G_i = c_i · ∂loss/∂image + z_i · ∂loss/∂Σwz + ∂loss/∂Σw
//
// The backward pass runs back to front: B, what lies behind, is then an average of the G's and keeps its digits however dark it is
// there, while front to back it would be a difference of nearly equal sums. Coordinates are relative to the tile's centre.
#pragma once

#include "raster_types.h"
#include "simd.h"

namespace radiant::RADIANT_ISA {

typedef float Row8 __attribute__((vector_size(32), aligned(4), may_alias));
typedef float Row4 __attribute__((vector_size(16), aligned(4), may_alias));

// One Gaussian as seen from a tile's centre: u = l11 x + l12 y + u0, v = l22 y + v0.
struct Local {
  float l11, l12, u0, l22, v0, log2_opacity, red, green, blue, depth, unused0, unused1;
};

struct PixelGrid {
  alignas(64) float x[kBlocksPerTile][kPixelsPerBlock], y[kBlocksPerTile][kPixelsPerBlock];
  alignas(64) float monomials[kBlocksPerTile][kPixelsPerBlock][8];  // 1, x, y, xx, xy, yy, 0, 0
  alignas(64) float low_x[kBlocksPerTile], low_y[kBlocksPerTile];   // first pixel centre of each block
};

// Made by the compiler: code that ran at load time might need a CPU that this one is not.
constexpr PixelGrid make_grid() {
  PixelGrid grid{};
  for (int block = 0; block < kBlocksPerTile; ++block) {
    grid.low_x[block] = static_cast<float>(block % 4 * kBlockPx) - 7.5f;
    grid.low_y[block] = static_cast<float>(block / 4 * kBlockPx) - 7.5f;
    for (int pixel = 0; pixel < kPixelsPerBlock; ++pixel) {
      const float x = grid.low_x[block] + static_cast<float>(pixel % 4), y = grid.low_y[block] + static_cast<float>(pixel / 4);
      grid.x[block][pixel] = x;
      grid.y[block][pixel] = y;
      const float monomials[6] = {1, x, y, x * x, x * y, y * y};
      for (int k = 0; k < 6; ++k) grid.monomials[block][pixel][k] = monomials[k];
    }
  }
  return grid;
}
static constexpr PixelGrid kGrid = make_grid();

struct TilePlace {
  int left, top;       // px of its first pixel
  uint32_t blocks;     // those that have a pixel in the image
};

RADIANT_INLINE TilePlace place_of(const View& view, int tile) {
  TilePlace place{tile % view.tiles_x * kTilePx, tile / view.tiles_x * kTilePx, 0};
  for (int block = 0; block < kBlocksPerTile; ++block)
    if (place.left + block % 4 * kBlockPx < view.width && place.top + block / 4 * kBlockPx < view.height) place.blocks |= 1u << block;
  return place;
}

RADIANT_INLINE void localize(const TilePlace& place, const Footprint& g, Local& local, float& x, float& y) {
  // Whole pixels first: their difference is exact.
  x = (g.whole_x - static_cast<float>(place.left + kTilePx / 2)) + g.rest_x;
  y = (g.whole_y - static_cast<float>(place.top + kTilePx / 2)) + g.rest_y;
  local = {g.l11, g.l12, -(g.l11 * x + g.l12 * y), g.l22, -(g.l22 * y), g.log2_opacity, g.red, g.green, g.blue, g.depth_m, 0, 0};
}

// Blocks whose pixel centres come within α ≥ α_min: exact least distance of an ellipse and a rectangle, all 16 blocks at once.
RADIANT_INLINE uint32_t reached_blocks(const Footprint& g, float x, float y) {
  const F low_x = load(kGrid.low_x) - x, low_y = load(kGrid.low_y) - y, zero = broadcast(0.0f);
  const F high_x = low_x + (kBlockPx - 1.0f), high_y = low_y + (kBlockPx - 1.0f);
  const F side_x = clamp(zero, low_x, high_x), side_y = clamp(zero, low_y, high_y);
  const F on_x_y = clamp(side_x * -g.lean_y, low_y, high_y), on_y_x = clamp(side_y * -g.l12_over_l11, low_x, high_x);
  const F u1 = side_x * g.l11 + on_x_y * g.l12, v1 = on_x_y * g.l22, u2 = on_y_x * g.l11 + side_y * g.l12, v2 = side_y * g.l22;
  const float limit = (g.log2_opacity + 7.994353436858858f) * 1.0005f + 1e-3f;
  return bits_of(min(u1 * u1 + v1 * v1, u2 * u2 + v2 * v2) <= broadcast(limit));
}

RADIANT_INLINE F falloff(const Local& g, const F& x, const F& y) {
  const F u = x * broadcast(g.l11) + (y * broadcast(g.l12) + broadcast(g.u0)), v = y * broadcast(g.l22) + broadcast(g.v0);
  return exp2_of_negative<true>(min((broadcast(g.log2_opacity) - u * u) - v * v, broadcast(0.0f)));
}

static int64_t blend_scratch(int64_t count) {
  // Locals; 16 lists that all could be full; moments of 16 floats.
  return count * static_cast<int64_t>(sizeof(Local) / 4) + 16 * (count + 1) + 16 * count + 64;
}

// Locals, and block after block the list of entries that reach it; returns the lists, compacted.
RADIANT_INLINE uint32_t* list_blocks(const TilePlace& place, const Entry* entries, int64_t count, const BlendState& state, Local* locals,
                                     uint32_t* lists, uint32_t* counts) {
  constexpr int kAhead = 12;
  for (int block = 0; block < kBlocksPerTile; ++block) counts[block] = 0;
  for (int64_t i = 0; i < count; ++i) {
    if (i + kAhead < count) __builtin_prefetch(state.footprints + state.owners[entries[i + kAhead].instance]);
    const Footprint& g = state.footprints[state.owners[entries[i].instance]];
    float x, y;
    localize(place, g, locals[i], x, y);
    for (uint32_t left = reached_blocks(g, x, y) & place.blocks; left; left &= left - 1) {
      const int block = __builtin_ctz(left);
      lists[block * count + counts[block]++] = static_cast<uint32_t>(i);
    }
  }
  uint32_t* end = lists;
  for (int block = 0; block < kBlocksPerTile; ++block) {
    __builtin_memmove(end, lists + block * count, counts[block] * sizeof(uint32_t));
    end += counts[block];
  }
  return lists;
}

struct Blended {
  F red, green, blue, depth, transmittance;
  I last;
};

RADIANT_INLINE Blended blend_block(int block, const Local* locals, const uint32_t* list, uint32_t count) {
  const F x = load(kGrid.x[block]), y = load(kGrid.y[block]), zero = broadcast(0.0f);
  const F alpha_min = broadcast(kAlphaMin), alpha_max = broadcast(kAlphaMax), cut = broadcast(kTransmittanceCut);
  F red = zero, green = zero, blue = zero, depth = zero, running = broadcast(1.0f), final_transmittance = zero;
  I last = broadcast(static_cast<int32_t>(count));
  uint32_t live = 0xffff;
  for (uint32_t i = 0; i < count; ++i) {
    const Local& g = locals[list[i]];
    F alpha = min(falloff(g, x, y), alpha_max);
    alpha = keep(alpha_min <= alpha, alpha);
    const F weight_all = alpha * running, after = running - weight_all;
    const Mask going_on = cut < after;
    const uint32_t live_now = bits_of(going_on);
    if (__builtin_expect(live_now != live, 0)) {
      // Rare: pixels that this Gaussian would bring to the cut keep what they had before it, for good.
      const Mask ended = mask_of(live & ~live_now);
      final_transmittance = select(ended, running, final_transmittance);
      last = select(ended, broadcast(static_cast<int32_t>(i)), last);
      live = live_now;
      if (!live) break;
    }
    const F weight = keep(going_on, weight_all);
    red += weight * broadcast(g.red);
    green += weight * broadcast(g.green);
    blue += weight * broadcast(g.blue);
    depth += weight * broadcast(g.depth);
    running = after;
  }
  return {red, green, blue, depth, select(mask_of(live), running, final_transmittance), last};
}

RADIANT_INLINE void write_block(const View& view, const TilePlace& place, int tile, int block, const Blended& b, const BlendState& state) {
  const int64_t at = (static_cast<int64_t>(tile) * kBlocksPerTile + block) * kPixelsPerBlock;
  store(state.transmittance + at, b.transmittance);
  store(state.last + at, b.last);
  const F alpha = 1.0f - b.transmittance;
  alignas(64) float out[5][kLanes];
  store(out[0], b.red + b.transmittance * view.background[0]);
  store(out[1], b.green + b.transmittance * view.background[1]);
  store(out[2], b.blue + b.transmittance * view.background[2]);
  store(out[3], alpha);
  store(out[4], b.depth / max(alpha, broadcast(1e-10f)));
  const int left = place.left + block % 4 * kBlockPx, top = place.top + block / 4 * kBlockPx;
  const int columns = view.width - left < kBlockPx ? view.width - left : kBlockPx;
  const int rows = view.height - top < kBlockPx ? view.height - top : kBlockPx;
  for (int row = 0; row < rows; ++row) {
    const int64_t pixel = static_cast<int64_t>(top + row) * view.width + left;
    for (int column = 0; column < columns; ++column) {
      const int lane = row * kBlockPx + column;
      for (int c = 0; c < 3; ++c) state.images[3 * (pixel + column) + c] = out[c][lane];
      state.alphas[pixel + column] = out[3][lane];
      state.depths[pixel + column] = out[4][lane];
    }
  }
}

static const uint32_t* blend(const View& view, int tile, const Entry* entries, int64_t count, const BlendState& state, float* scratch,
                             uint32_t* counts) {
  Local* locals = reinterpret_cast<Local*>(scratch);
  uint32_t* lists = reinterpret_cast<uint32_t*>(locals + count);
  const TilePlace place = place_of(view, tile);
  lists = list_blocks(place, entries, count, state, locals, lists, counts);
  const uint32_t* list = lists;
  for (int block = 0; block < kBlocksPerTile; ++block) {
    if (place.blocks >> block & 1) write_block(view, place, tile, block, blend_block(block, locals, list, counts[block]), state);
    list += counts[block];
  }
  return lists;
}

// ∂loss per pixel of a block: as rows for the sums, as lanes for the recursion.
struct PixelGradients {
  alignas(64) float rows[kPixelsPerBlock][4];  // red, green, blue, Σwz
  F red, green, blue, depth, alpha;
};

RADIANT_INLINE void load_gradients(const View& view, const TilePlace& place, int block, const ImageGradients& from, PixelGradients& g) {
  alignas(64) float lanes[5][kLanes] = {};
  __builtin_memset(g.rows, 0, sizeof(g.rows));
  const int left = place.left + block % 4 * kBlockPx, top = place.top + block / 4 * kBlockPx;
  const int columns = view.width - left < kBlockPx ? view.width - left : kBlockPx;
  const int rows = view.height - top < kBlockPx ? view.height - top : kBlockPx;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      const int lane = row * kBlockPx + column;
      const int64_t pixel = static_cast<int64_t>(top + row) * view.width + left + column;
      float alpha = from.alphas ? from.alphas[pixel] : 0.0f, depth = 0.0f;
      for (int c = 0; c < 3; ++c) {
        const float gradient = from.images[3 * pixel + c];
        g.rows[lane][c] = lanes[c][lane] = gradient;
        alpha -= gradient * view.background[c];
      }
      if (from.depths) {
        // depth = Σwz / Σw
        const float sum = 1.0f - from.transmittance[lane];
        depth = sum < 1e-10f ? 0.0f : from.depths[pixel] / sum;
        alpha -= depth * from.out_depths[pixel];
      }
      g.rows[lane][3] = lanes[3][lane] = depth;
      lanes[4][lane] = alpha;
    }
  g.red = load(lanes[0]), g.green = load(lanes[1]), g.blue = load(lanes[2]), g.depth = load(lanes[3]), g.alpha = load(lanes[4]);
}

// Sums of one tile's instance, in the tile's coordinates: (1, x, y, xx, xy, yy) h and (red, green, blue, depth) w.
struct alignas(16) TileSums {
  float h[8], w[4], unused[4];
};

// Adds Σ_p h_p · monomials_p and Σ_p w_p · gradient_p: a 2 × 16 by 16 × (6 + 4) matrix product without a horizontal sum.
RADIANT_INLINE void add_moments(const float* h, const float* w, const float (*monomials)[8], const float (*gradients)[4], TileSums& sums) {
  Row8 h0 = *reinterpret_cast<const Row8*>(sums.h), h1{}, h2{}, h3{};
  Row4 w0 = *reinterpret_cast<const Row4*>(sums.w), w1{}, w2{}, w3{};
#pragma GCC unroll 4
  for (int p = 0; p < kPixelsPerBlock; p += 4) {
    h0 += h[p] * *reinterpret_cast<const Row8*>(monomials[p]);
    h1 += h[p + 1] * *reinterpret_cast<const Row8*>(monomials[p + 1]);
    h2 += h[p + 2] * *reinterpret_cast<const Row8*>(monomials[p + 2]);
    h3 += h[p + 3] * *reinterpret_cast<const Row8*>(monomials[p + 3]);
    w0 += w[p] * *reinterpret_cast<const Row4*>(gradients[p]);
    w1 += w[p + 1] * *reinterpret_cast<const Row4*>(gradients[p + 1]);
    w2 += w[p + 2] * *reinterpret_cast<const Row4*>(gradients[p + 2]);
    w3 += w[p + 3] * *reinterpret_cast<const Row4*>(gradients[p + 3]);
  }
  *reinterpret_cast<Row8*>(sums.h) = (h0 + h1) + (h2 + h3);
  *reinterpret_cast<Row4*>(sums.w) = (w0 + w1) + (w2 + w3);
}

RADIANT_INLINE void blend_block_backward(int block, const Local* locals, const uint32_t* list, uint32_t count, const F& end_transmittance,
                                         const I& last, const PixelGradients& g, TileSums* sums) {
  const F x = load(kGrid.x[block]), y = load(kGrid.y[block]);
  const F alpha_min = broadcast(kAlphaMin), alpha_max = broadcast(kAlphaMax);
  F transmittance = end_transmittance, behind = broadcast(0.0f);
  alignas(64) int32_t last_of[kLanes];
  store(last_of, last);
  uint32_t top = 0;
  for (int lane = 0; lane < kLanes; ++lane) top = static_cast<uint32_t>(last_of[lane]) > top ? static_cast<uint32_t>(last_of[lane]) : top;
  if (top > count) top = count;
  for (uint32_t i = top; i-- > 0;) {
    const Local& gaussian = locals[list[i]];
    const F free_alpha = falloff(gaussian, x, y);
    F alpha = min(free_alpha, alpha_max);
    alpha = keep((alpha_min <= alpha) & (broadcast(static_cast<int32_t>(i)) < last), alpha);
    transmittance *= reciprocal(1.0f - alpha);
    const F weight = alpha * transmittance;
    const F ahead = (g.red * broadcast(gaussian.red) + (g.green * broadcast(gaussian.green) +
                    (g.blue * broadcast(gaussian.blue) + (g.depth * broadcast(gaussian.depth) + g.alpha)))) - behind;
    behind += alpha * ahead;
    // Where α is capped, nothing that moves the Gaussian changes it.
    alignas(64) float h[kLanes], w[kLanes];
    store(h, keep(free_alpha <= alpha_max, weight * ahead));
    store(w, weight);
    add_moments(h, w, kGrid.monomials[block], g.rows, sums[list[i]]);
  }
}

// From the tile's coordinates to the Gaussian's own (u, v).
RADIANT_INLINE Moments centered(const Local& g, const TileSums& s) {
  const float m0 = s.h[0], mx = s.h[1], my = s.h[2], mxx = s.h[3], mxy = s.h[4], myy = s.h[5];
  const float along = g.l11 * mx + g.l12 * my, hu = along + g.u0 * m0, hv = g.l22 * my + g.v0 * m0;
  const float huu = g.l11 * (g.l11 * mxx + 2.0f * g.l12 * mxy) + g.l12 * g.l12 * myy + g.u0 * (2.0f * along + g.u0 * m0);
  const float huv = g.l22 * (g.l11 * mxy + g.l12 * myy + g.u0 * my) + g.v0 * hu;
  const float hvv = g.l22 * g.l22 * myy + g.v0 * (2.0f * g.l22 * my + g.v0 * m0);
  constexpr float scale = 1.0f / kHalfLog2e;
  // A colour that was clamped at 0 has no gradient.
  return {m0, scale * g.l11 * hu, scale * (g.l12 * hu + g.l22 * hv), huu, huv, hvv,
          g.red > 0 ? s.w[0] : 0, g.green > 0 ? s.w[1] : 0, g.blue > 0 ? s.w[2] : 0, s.w[3]};
}

static void blend_backward(const View& view, int tile, const Entry* entries, int64_t count, const TileLists& lists, const BlendState& state,
                           const ImageGradients& gradients, float* scratch, Moments* moments) {
  constexpr int kAhead = 12;
  Local* locals = reinterpret_cast<Local*>(scratch);
  TileSums* sums = reinterpret_cast<TileSums*>(locals + count);
  const TilePlace place = place_of(view, tile);
  for (int64_t i = 0; i < count; ++i) {
    if (i + kAhead < count) __builtin_prefetch(state.footprints + state.owners[entries[i + kAhead].instance]);
    float x, y;
    localize(place, state.footprints[state.owners[entries[i].instance]], locals[i], x, y);
  }
  __builtin_memset(sums, 0, static_cast<size_t>(count) * sizeof(TileSums));
  const uint32_t* list = lists.indices;
  for (int block = 0; block < kBlocksPerTile; ++block) {
    if (lists.counts[block] == 0) continue;
    const int64_t at = (static_cast<int64_t>(tile) * kBlocksPerTile + block) * kPixelsPerBlock;
    ImageGradients here = gradients;
    here.transmittance = state.transmittance + at;
    PixelGradients pixels;
    load_gradients(view, place, block, here, pixels);
    blend_block_backward(block, locals, list, lists.counts[block], load(state.transmittance + at), load(state.last + at), pixels, sums);
    list += lists.counts[block];
  }
  for (int64_t i = 0; i < count; ++i) moments[entries[i].instance] = centered(locals[i], sums[i]);
}

}  // namespace radiant::RADIANT_ISA
