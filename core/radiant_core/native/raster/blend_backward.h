// One tile on the way back: moments of every instance, from which project_backward makes all
// gradients. Per tile and camera.
//
// With g the pixel's gradient, T_i the transmittance before Gaussian i, B_i what is seen behind it:
//     ∂loss/∂ln α_i = w_i (c_i·g − B_i)
//     B_{i−1} = B_i + α_i (c_i·g − B_i),   T_i = T_{i+1} / (1 − α_i)
// From back to front both recurrences only add small things to sums of small things: a Gaussian
// behind an almost opaque one keeps all digits of its gradient, unlike "all minus what is in
// front". The loop is over Gaussians, inside over their blocks: an instance's sums stay in
// registers and are reduced once. On request, Σ|h u| and Σ|h (l₁₂ u + l₂₂ v)| give Σ|∂loss/∂m|,
// and Σ w the pixels that a Gaussian makes.
#pragma once

#include "raster/blend.h"

namespace radiant::RADIANT_ISA {

struct BlockState {
  F transmittance, behind, red, green, blue, depth;  // T, B, g
  F final_transmittance, final_behind, picture_depth;
  F x, y;                                            // pixels from the tile's centre
  int32_t last[kLanes];
  int32_t end;    // the largest `last`
  int32_t next;  // pixels of the block whose `last` is beyond the entry at hand start at `next`
};

// Gradients of 16 pixels from a picture (H,W,stride); 0 outside.
RADIANT_INLINE F read_block(const View& view, int left, int top, const float* picture, int stride) {
  alignas(64) float values[kLanes] = {};
  const int rows = view.height - top < kBlockPx ? view.height - top : kBlockPx, columns = view.width - left < kBlockPx ? view.width - left : kBlockPx;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      values[row * kBlockPx + column] = picture[(static_cast<int64_t>(top + row) * view.width + left + column) * stride];
  return load(values);
}

// Which of the 16 pixels are in the picture.
RADIANT_INLINE uint32_t pixels_inside(const View& view, int left, int top) {
  const int rows = view.height - top < kBlockPx ? view.height - top : kBlockPx, columns = view.width - left < kBlockPx ? view.width - left : kBlockPx;
  uint32_t inside = 0;
  for (int row = 0; row < rows; ++row) inside |= ((1u << columns) - 1) << row * kBlockPx;
  return inside;
}

// B behind everything is background·g − ∂loss/∂alpha, since alpha = 1 − T; depth = Σ w z / Σ w adds
// (z − depth) / Σ w to c·g.
RADIANT_INLINE void start_block(const View& view, int tile, int block, int64_t count, const BlendState& state, const ImageGradients& gradients,
                                BlockState& b) {
  const int left = tile % view.tiles_x * kTilePx + block % 4 * kBlockPx, top = tile / view.tiles_x * kTilePx + block / 4 * kBlockPx;
  const int64_t place = (static_cast<int64_t>(tile) * kBlocksPerTile + block) * kPixelsPerBlock;
  const F zero = broadcast(0.0f);
  b.x = lane_x() + block_left(block), b.y = lane_y() + block_top(block);
  b.red = b.green = b.blue = b.depth = b.picture_depth = zero;
  if (gradients.images) {
    b.red = read_block(view, left, top, gradients.images, 3);
    b.green = read_block(view, left, top, gradients.images + 1, 3);
    b.blue = read_block(view, left, top, gradients.images + 2, 3);
  }
  b.final_behind = view.background[0] * b.red + view.background[1] * b.green + view.background[2] * b.blue;
  if (gradients.alphas) b.final_behind -= read_block(view, left, top, gradients.alphas, 1);
  if (gradients.depths) {
    b.picture_depth = read_block(view, left, top, gradients.out_depths, 1);
    b.depth = read_block(view, left, top, gradients.depths, 1) / max(read_block(view, left, top, gradients.out_alphas, 1), broadcast(1e-10f));
  }
  // Outside it nothing is shown: no weight.
  b.final_transmittance = keep(mask_of(pixels_inside(view, left, top)), load(state.transmittance + place));
  b.next = b.end = 0;
  alignas(64) int32_t started[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    b.last[lane] = state.last[place + lane];
    started[lane] = b.last[lane] == count;
    if (b.last[lane] < count && b.last[lane] > b.next) b.next = b.last[lane];
    if (b.last[lane] > b.end) b.end = b.last[lane];
  }
  b.behind = b.final_behind;
  b.transmittance = keep(broadcast(int32_t{0}) < load(started), b.final_transmittance);
}

// Whether no pixel of the block has a gradient, as behind a mask: its moments are 0. NaN is a
// gradient.
RADIANT_INLINE bool has_no_gradient(const BlockState& b) {
  const F zero = broadcast(0.0f);
  const uint32_t none = bits_of(abs(b.red) <= zero) & bits_of(abs(b.green) <= zero) & bits_of(abs(b.blue) <= zero) & bits_of(abs(b.depth) <= zero) &
                        bits_of(abs(b.final_behind) <= zero);
  return none == (1u << kLanes) - 1;
}

// Starts the pixels whose last blended entry is this one or behind it.
static __attribute__((noinline)) void start_pixels(BlockState& b, int32_t entry) {
  uint32_t starting = 0;
  int32_t next = 0;
  for (int lane = 0; lane < kLanes; ++lane) {
    if (b.last[lane] > entry && b.last[lane] <= b.next) starting |= 1u << lane;
    if (b.last[lane] <= entry && b.last[lane] > next) next = b.last[lane];
  }
  b.transmittance = select(mask_of(starting), b.final_transmittance, b.transmittance);
  b.behind = select(mask_of(starting), b.final_behind, b.behind);
  b.next = next;
}

// Moments of one Gaussian over its blocks. kCapped: its opacity is over the cap, so that α may be
// cut off. One register of a block at a time, so that the sums fit on CPUs with 16 registers too.
template <bool kDepth, bool kCapped, bool kAbsolute>
RADIANT_INLINE void instance_moments(const Row& row, uint32_t reached, int32_t entry, BlockState* blocks, Moments* out,
                                     AbsoluteMoments* absolute) {
  constexpr int kSums = kAbsolute ? kMoments + 3 : kMoments;
  Part sums[kSums];
  for (int i = 0; i < kSums; ++i) sums[i] = broadcast<1>(0.0f);
  for (; reached; reached &= reached - 1) {
    BlockState& b = blocks[__builtin_ctz(reached)];
    if (__builtin_expect(entry < b.next, 0)) start_pixels(b, entry);
    for (int i = 0; i < kParts; ++i) {
      Part u, v;
      const Part t = log2_alpha(row, part(b.x, i), part(b.y, i), u, v);
      const Part free_alpha = keep(broadcast<1>(kLog2AlphaMin) <= t, exp2_of_negative(t));
      const Part alpha = kCapped ? min(free_alpha, broadcast<1>(kAlphaMax)) : free_alpha;
      const Part transmittance = part(b.transmittance, i) * reciprocal(1.0f - alpha), weight = alpha * transmittance;
      const Part red = part(b.red, i), green = part(b.green, i), blue = part(b.blue, i), behind = part(b.behind, i);
      Part difference = fma(row.red, red, fma(row.green, green, fma(row.blue, blue, -behind)));
      if (kDepth) difference = fma(row.depth_m - part(b.picture_depth, i), part(b.depth, i), difference);
      b.transmittance.p[i] = transmittance.p[0];
      b.behind.p[i] = fma(alpha, difference, behind).p[0];
      Part h = weight * difference;
      // At the cap α does not move.
      if (kCapped) h = keep(t <= broadcast<1>(kLog2AlphaMax), h);
      const Part hu = h * u, hv = h * v;
      sums[0] += h;
      sums[1] += hu;
      sums[2] += hv;
      sums[3] = fma(hu, u, sums[3]);
      sums[4] = fma(hu, v, sums[4]);
      sums[5] = fma(hv, v, sums[5]);
      sums[6] = fma(weight, red, sums[6]);
      sums[7] = fma(weight, green, sums[7]);
      sums[8] = fma(weight, blue, sums[8]);
      if (kDepth) sums[9] = fma(weight, part(b.depth, i), sums[9]);
      if constexpr (kAbsolute) {
        sums[kMoments] += abs(hu);
        sums[kMoments + 1] += abs(fma(row.l12, hu, row.l22 * hv));
        sums[kMoments + 2] += weight;
      }
    }
  }
  if constexpr (kAbsolute) {
    float all[kSums];
    sums_of_rows<kSums>(sums, all);
    __builtin_memcpy(out, all, sizeof(Moments));
    __builtin_memcpy(absolute, all + kMoments, sizeof(AbsoluteMoments));
  } else {
    sums_of_rows<kMoments>(sums, reinterpret_cast<float*>(out));
  }
}

// Blocks that have a pixel which still goes on at entry `first`.
RADIANT_INLINE uint32_t blocks_alive(const int32_t* ends, int64_t first) { return bits_of(broadcast(static_cast<int32_t>(first)) < load(ends)); }

template <bool kDepth, bool kAbsolute>
static void walk_back(const View& view, int tile, const Entry* entries, int64_t offset, int64_t count, const BlendState& state,
                      BlockState* blocks, Row* rows, Moments* moments, AbsoluteMoments* absolute) {
  const int left = tile % view.tiles_x * kTilePx, top = tile / view.tiles_x * kTilePx;
  alignas(64) int32_t ends[kBlocksPerTile];
  for (int block = 0; block < kBlocksPerTile; ++block) ends[block] = blocks[block].end;
  for (int64_t first = padded(count) - kLanes; first >= 0; first -= kLanes) {
    const int lanes = count - first < kLanes ? static_cast<int>(count - first) : kLanes;
    for (int64_t next = first - kLanes; next >= 0 && next < first; ++next) __builtin_prefetch(state.footprints + entries[next].owner);
    const uint32_t alive = blocks_alive(ends, first);
    if (alive) load_group(state.footprints, entries + first, lanes, left + kTilePx / 2, top + kTilePx / 2, rows);
    for (int lane = lanes - 1; lane >= 0; --lane) {
      const int64_t entry = first + lane;
      Moments* const out = moments + entries[entry].instance;
      AbsoluteMoments* const out_absolute = kAbsolute ? absolute + entries[entry].instance : nullptr;
      const uint32_t reached = state.reached[offset + entry] & alive;
      const auto at = static_cast<int32_t>(entry);
      if (!reached) {
        *out = {};
        if constexpr (kAbsolute) *out_absolute = {};
      } else if (rows[lane].log2_opacity <= kLog2AlphaMax) {
        instance_moments<kDepth, false, kAbsolute>(rows[lane], reached, at, blocks, out, out_absolute);
      } else {
        instance_moments<kDepth, true, kAbsolute>(rows[lane], reached, at, blocks, out, out_absolute);
      }
    }
  }
}

static void blend_backward(const View& view, int tile, const Entry* entries, int64_t offset, int64_t count, const BlendState& state,
                           const ImageGradients& gradients, Moments* moments, AbsoluteMoments* absolute) {
  BlockState blocks[kBlocksPerTile];
  Row rows[kLanes];
  for (int block = 0; block < kBlocksPerTile; ++block) {
    const int left = tile % view.tiles_x * kTilePx + block % 4 * kBlockPx, top = tile / view.tiles_x * kTilePx + block / 4 * kBlockPx;
    blocks[block].end = 0;
    if (left >= view.width || top >= view.height) continue;
    start_block(view, tile, block, count, state, gradients, blocks[block]);
    // Weights are no gradients: `absolute` has them of every pixel.
    if (!absolute && has_no_gradient(blocks[block])) blocks[block].end = 0;
  }
  const auto walk = gradients.depths ? (absolute ? walk_back<true, true> : walk_back<true, false>)
                                     : (absolute ? walk_back<false, true> : walk_back<false, false>);
  walk(view, tile, entries, offset, count, state, blocks, rows, moments, absolute);
}

}  // namespace radiant::RADIANT_ISA
