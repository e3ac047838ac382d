// One tile of the picture: cull, blend front to back (3DGS, Kerbl 2023). Once per tile and camera.
//
//     image(p) = Σ_i c_i w_i + background · (1 − Σ_i w_i),   w_i = α_i Π_{k<i} (1 − α_k)
// The loop is over one block of 16 pixels, inside over its own list: all sums stay in registers. A
// finished pixel has transmittance 0, so nothing adds to it; its own transmittance is put aside.
#pragma once

#include "raster/tile.h"

namespace radiant::RADIANT_ISA {

// How a tile's scratch memory is divided.
struct Scratch {
  Row* rows;             // ⌈count/16⌉ · 16
  uint32_t* lists;       // 16 blocks of `list_size`
  int64_t list_size;
};

inline int64_t padded(int64_t count) { return (count + kLanes - 1) / kLanes * kLanes; }

static int64_t blend_scratch(int64_t count) {
  const int64_t entries = padded(count);
  return entries * static_cast<int64_t>(sizeof(Row)) + kBlocksPerTile * (entries + kLanes) * static_cast<int64_t>(sizeof(uint32_t)) + 4096;
}

inline Scratch divided(char* scratch, int64_t count) {
  const int64_t entries = padded(count);
  return {reinterpret_cast<Row*>(scratch), reinterpret_cast<uint32_t*>(scratch + entries * sizeof(Row)), entries + kLanes};
}

struct Pixels {
  F transmittance, red, green, blue, depth, weight;
};

// log₂ α before the cap at pixels (x, y) from the tile's centre, the same to the last bit on the
// way back; and (u, v).
template <int P>
RADIANT_INLINE Floats<P> log2_alpha(const Row& row, const Floats<P>& x, const Floats<P>& y, Floats<P>& u, Floats<P>& v) {
  u = fma(row.l11, x, fma(row.l12, y, row.u));
  v = fma(row.l22, y, row.v);
  return fnma(v, v, fnma(u, u, broadcast<P>(row.log2_opacity)));
}

// α at 16 pixels, 0 where it is under α_min or no number; t = log₂ of it before the cap.
RADIANT_INLINE F alpha_of(const F& t) {
  return keep(broadcast(kLog2AlphaMin) <= t, min(exp2_of_negative(t), broadcast(kAlphaMax)));
}

// Blends the Gaussians of `list` into the 16 pixels at (x, y) from the tile's centre. `last` keeps
// what it holds for pixels that no Gaussian finishes.
RADIANT_INLINE Pixels blend_block(const Row* rows, const uint32_t* list, uint32_t count, const F& x, const F& y, int32_t* last) {
  const F zero = broadcast(0.0f);
  Pixels p = {broadcast(1.0f), zero, zero, zero, zero, zero};
  F finished = zero;
  uint32_t alive = 0xffff;
  for (uint32_t i = 0; i < count; ++i) {
    const Row& row = rows[list[i]];
    F u, v;
    const F alpha = alpha_of(log2_alpha(row, x, y, u, v));
    F weight = alpha * p.transmittance;
    F after = p.transmittance - weight;
    const uint32_t going_on = bits_of(broadcast(kTransmittanceCut) < after);
    if (__builtin_expect(going_on != alive, 0)) {
      for (uint32_t dying = alive & ~going_on; dying; dying &= dying - 1) last[__builtin_ctz(dying)] = static_cast<int32_t>(list[i]);
      finished = select(mask_of(alive & ~going_on), p.transmittance, finished);
      alive = going_on;
      weight = keep(mask_of(alive), weight);
      after = keep(mask_of(alive), after);
      if (!alive) {
        p.transmittance = zero;
        break;
      }
    }
    p.transmittance = after;
    p.red = fma(row.red, weight, p.red);
    p.green = fma(row.green, weight, p.green);
    p.blue = fma(row.blue, weight, p.blue);
    p.depth = fma(row.depth_m, weight, p.depth);
    p.weight += weight;
  }
  p.transmittance = p.transmittance + finished;
  return p;
}

// Writes the pixels of a block whose corner is (left, top) px; those outside the image are dropped.
RADIANT_INLINE void write_block(const View& view, int left, int top, const Pixels& p, const BlendState& state) {
  const F background = 1.0f - p.weight;
  alignas(64) float red[kLanes], green[kLanes], blue[kLanes], alpha[kLanes], depth[kLanes];
  store(red, p.red + view.background[0] * background);
  store(green, p.green + view.background[1] * background);
  store(blue, p.blue + view.background[2] * background);
  store(alpha, p.weight);
  store(depth, p.depth / max(p.weight, broadcast(1e-10f)));
  const int rows = view.height - top < kBlockPx ? view.height - top : kBlockPx, columns = view.width - left < kBlockPx ? view.width - left : kBlockPx;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column) {
      const int64_t pixel = static_cast<int64_t>(top + row) * view.width + left + column;
      const int lane = row * kBlockPx + column;
      state.images[3 * pixel] = red[lane];
      state.images[3 * pixel + 1] = green[lane];
      state.images[3 * pixel + 2] = blue[lane];
      state.alphas[pixel] = alpha[lane];
      state.depths[pixel] = depth[lane];
    }
}

// Rows of all entries, a list of entries per block, and which blocks each entry reaches.
RADIANT_INLINE void list_entries(const View& view, int left, int top, const Entry* entries, int64_t offset, int64_t count, const BlendState& state,
                                 const Scratch& scratch, uint32_t counts[kBlocksPerTile]) {
  for (int64_t first = 0; first < count; first += kLanes) {
    const int lanes = count - first < kLanes ? static_cast<int>(count - first) : kLanes;
    for (int64_t next = first + kLanes; next < first + 2 * kLanes && next < count; ++next)
      __builtin_prefetch(state.footprints + entries[next].owner);
    const Group group = load_group(state.footprints, entries + first, lanes, left + kTilePx / 2, top + kTilePx / 2, scratch.rows + first);
    uint32_t hits[kBlocksPerTile];
    cull(group, hits);
    for (int block = 0; block < kBlocksPerTile; ++block) {
      const bool inside = left + block % 4 * kBlockPx < view.width && top + block / 4 * kBlockPx < view.height;
      hits[block] &= inside ? (1u << lanes) - 1 : 0;
      counts[block] += append(scratch.lists + block * scratch.list_size + counts[block], hits[block], static_cast<uint32_t>(first));
    }
    uint16_t reached[kLanes];
    transpose_bits(hits, reached);
    __builtin_memcpy(state.reached + offset + first, reached, lanes * sizeof(uint16_t));
  }
}

static void blend(const View& view, int tile, const Entry* entries, int64_t offset, int64_t count, const BlendState& state, char* memory) {
  const Scratch scratch = divided(memory, count);
  const int left = tile % view.tiles_x * kTilePx, top = tile / view.tiles_x * kTilePx;
  uint32_t counts[kBlocksPerTile] = {};
  list_entries(view, left, top, entries, offset, count, state, scratch, counts);
  for (int block = 0; block < kBlocksPerTile; ++block) {
    const int block_x = left + block % 4 * kBlockPx, block_y = top + block / 4 * kBlockPx;
    if (block_x >= view.width || block_y >= view.height) continue;
    const int64_t place = (static_cast<int64_t>(tile) * kBlocksPerTile + block) * kPixelsPerBlock;
    int32_t* last = state.last + place;
    for (int lane = 0; lane < kLanes; ++lane) last[lane] = static_cast<int32_t>(count);
    const F x = lane_x() + block_left(block), y = lane_y() + block_top(block);
    const Pixels pixels = blend_block(scratch.rows, scratch.lists + block * scratch.list_size, counts[block], x, y, last);
    store(state.transmittance + place, pixels.transmittance);
    write_block(view, block_x, block_y, pixels, state);
  }
}

}  // namespace radiant::RADIANT_ISA
