// The Gaussians of one tile: by depth, relative to the tile, listed per block of 4 × 4 pixels.
#pragma once

#include "machine/simd_math.h"
#include "machine/simd_rows.h"
#include "raster/types.h"

namespace radiant::RADIANT_ISA {

// One Gaussian as pixel loops broadcast it: (u, v) at the tile's centre, then as in Footprint.
struct alignas(64) Row {
  float u, v, l11, l12, l22, log2_opacity, red, green, blue, depth_m, unused[6];
};

constexpr float kLog2AlphaMin = -7.994353436858858f;
constexpr float kLog2AlphaMax = -0.00144341687f;

RADIANT_INLINE float block_left(int block) { return static_cast<float>(block % 4 * kBlockPx) - kTilePx / 2 + 0.5f; }
RADIANT_INLINE float block_top(int block) { return static_cast<float>(block / 4 * kBlockPx) - kTilePx / 2 + 0.5f; }

RADIANT_INLINE F lane_x() {
  constexpr float x[kLanes] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
  return load(x);
}
RADIANT_INLINE F lane_y() {
  constexpr float y[kLanes] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};
  return load(y);
}

struct Group {
  F dx, dy;                        // from the Gaussian's centre to the tile's, px
  F l11, l22, slope, lean, limit;  // limit: largest u² + v² that counts
};

// Reads the footprints of up to 16 entries, writes their rows, and returns what the culling needs.
RADIANT_INLINE Group load_group(const Footprint* footprints, const Entry* entries, int lanes, float center_x, float center_y, Row* rows) {
  F r[kLanes];
  for (int lane = 0; lane < kLanes; ++lane)
    r[lane] = load(reinterpret_cast<const float*>(footprints + entries[lane < lanes ? lane : lanes - 1].owner));
  transpose(r);
  Group g;
  // In this order: added to whole pixels first, the rest would lose digits (2e-6 px at 100 px).
  g.dx = (center_x - r[0]) - r[2];
  g.dy = (center_y - r[1]) - r[3];
  g.l11 = r[4], g.l22 = r[6], g.slope = r[12], g.lean = r[13];
  g.limit = r[7] - kLog2AlphaMin;
  const F zero = broadcast(0.0f);
  F out[kLanes] = {g.l11 * (g.dx + g.slope * g.dy), g.l22 * g.dy, r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], zero, zero, zero, zero, zero, zero};
  transpose(out);
  for (int lane = 0; lane < kLanes; ++lane) store(reinterpret_cast<float*>(rows + lane), out[lane]);
  return g;
}

// Appends first + (set bits of hits) to a list with room for 16 more than it will hold.
RADIANT_INLINE uint32_t append(uint32_t* list, uint32_t hits, uint32_t first) {
#if defined(__AVX512F__)
  const __m512i index = _mm512_add_epi32(_mm512_set1_epi32(static_cast<int>(first)), _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0));
  // Compressed in a register: straight to memory it is microcoded on some CPUs.
  _mm512_storeu_si512(list, _mm512_maskz_compress_epi32(static_cast<__mmask16>(hits), index));
#else
  uint32_t* to = list;
  for (uint32_t left = hits; left; left &= left - 1) *to++ = first + static_cast<uint32_t>(__builtin_ctz(left));
#endif
  return static_cast<uint32_t>(__builtin_popcount(hits));
}

// Which of 16 Gaussians reach each block: bit i of hits[block]. The smallest u² + v² over a box of
// pixel centres lies on the sides that face the Gaussian: at y = −lean x on the nearest vertical
// one, or at x = −slope y on the nearest horizontal one.
RADIANT_INLINE void cull(const Group& g, uint32_t hits[kBlocksPerTile]) {
  const F zero = broadcast(0.0f), limit = g.limit * 1.0005f + 1e-3f;
  F left[4], near_x[4], best_y[4], top[4], near_y[4], best_x[4], lean_x[4], v2[4];
  for (int i = 0; i < 4; ++i) {
    left[i] = g.dx + block_left(i);
    near_x[i] = clamp(zero, left[i], left[i] + 3.0f);
    best_y[i] = zero - g.lean * near_x[i];
    top[i] = g.dy + block_top(4 * i);
    near_y[i] = clamp(zero, top[i], top[i] + 3.0f);
    lean_x[i] = g.slope * near_y[i];
    best_x[i] = zero - lean_x[i];
    const F v = g.l22 * near_y[i];
    v2[i] = v * v;
  }
  for (int block = 0; block < kBlocksPerTile; ++block) {
    const int i = block % 4, j = block / 4;
    const F y = clamp(best_y[i], top[j], top[j] + 3.0f), x = clamp(best_x[j], left[i], left[i] + 3.0f);
    const F u1 = g.l11 * (near_x[i] + g.slope * y), v1 = g.l22 * y, u2 = g.l11 * (x + lean_x[j]);
    hits[block] = bits_of(min(u1 * u1 + v1 * v1, u2 * u2 + v2[j]) <= limit);
  }
}

// Turns 16 words of 16 bits: bit i of word b becomes bit b of word i.
RADIANT_INLINE void transpose_bits(const uint32_t in[kBlocksPerTile], uint16_t* out) {
#if defined(__AVX512BW__) && defined(__AVX512VL__)
  const __m256i words = _mm512_cvtepi32_epi16(_mm512_loadu_si512(in));
  for (int i = 0; i < 16; ++i) out[i] = static_cast<uint16_t>(_mm256_test_epi16_mask(words, _mm256_set1_epi16(static_cast<short>(1 << i))));
#else
  alignas(64) int32_t words[kLanes];
  __builtin_memcpy(words, in, sizeof(words));
  const I v = load(words);
  for (int i = 0; i < 16; ++i) {
    const I bit = v & broadcast(int32_t{1} << i);
    out[i] = static_cast<uint16_t>(bits_of(broadcast(int32_t{0}) < bit));
  }
#endif
}

}  // namespace radiant::RADIANT_ISA
