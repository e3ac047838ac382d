// Between lanes and rows: transposes, sums, and arrays whose rows belong to 16 Gaussians.
#pragma once

#include "machine/simd.h"

namespace radiant::RADIANT_ISA {

// Turns 16 rows of 16 into 16 columns.
RADIANT_INLINE void transpose(F rows[kLanes]) {
#if defined(__AVX512F__)
  // Unrolled by the pragma: left as loops, gcc keeps the arrays in memory, at five times the cost.
  __m512 a[16], b[16];
#pragma GCC unroll 16
  for (int i = 0; i < 16; i += 2) {
    a[i] = _mm512_unpacklo_ps(rows[i].p[0], rows[i + 1].p[0]);
    a[i + 1] = _mm512_unpackhi_ps(rows[i].p[0], rows[i + 1].p[0]);
  }
#pragma GCC unroll 16
  for (int i = 0; i < 16; i += 4)
#pragma GCC unroll 16
    for (int j = 0; j < 2; ++j) {
      b[i + 2 * j] = _mm512_castpd_ps(_mm512_unpacklo_pd(_mm512_castps_pd(a[i + j]), _mm512_castps_pd(a[i + 2 + j])));
      b[i + 2 * j + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(_mm512_castps_pd(a[i + j]), _mm512_castps_pd(a[i + 2 + j])));
    }
#pragma GCC unroll 16
  for (int j = 0; j < 4; ++j) {
    a[j] = _mm512_shuffle_f32x4(b[j], b[4 + j], 0x88);
    a[4 + j] = _mm512_shuffle_f32x4(b[j], b[4 + j], 0xdd);
    a[8 + j] = _mm512_shuffle_f32x4(b[8 + j], b[12 + j], 0x88);
    a[12 + j] = _mm512_shuffle_f32x4(b[8 + j], b[12 + j], 0xdd);
  }
#pragma GCC unroll 16
  for (int j = 0; j < 4; ++j) {
    rows[j].p[0] = _mm512_shuffle_f32x4(a[j], a[8 + j], 0x88);
    rows[8 + j].p[0] = _mm512_shuffle_f32x4(a[j], a[8 + j], 0xdd);
    rows[4 + j].p[0] = _mm512_shuffle_f32x4(a[4 + j], a[12 + j], 0x88);
    rows[12 + j].p[0] = _mm512_shuffle_f32x4(a[4 + j], a[12 + j], 0xdd);
  }
#else
  typedef float Quad __attribute__((vector_size(16), may_alias));
  alignas(64) float from[16][16], to[16][16];
  for (int i = 0; i < 16; ++i) store(from[i], rows[i]);
  for (int i = 0; i < 16; i += 4)
    for (int j = 0; j < 16; j += 4) {
      const Quad r0 = *reinterpret_cast<Quad*>(&from[i][j]), r1 = *reinterpret_cast<Quad*>(&from[i + 1][j]);
      const Quad r2 = *reinterpret_cast<Quad*>(&from[i + 2][j]), r3 = *reinterpret_cast<Quad*>(&from[i + 3][j]);
      const Quad low01 = RADIANT_SHUFFLE(r0, r1, 0, 4, 1, 5), high01 = RADIANT_SHUFFLE(r0, r1, 2, 6, 3, 7);
      const Quad low23 = RADIANT_SHUFFLE(r2, r3, 0, 4, 1, 5), high23 = RADIANT_SHUFFLE(r2, r3, 2, 6, 3, 7);
      *reinterpret_cast<Quad*>(&to[j][i]) = RADIANT_SHUFFLE(low01, low23, 0, 1, 4, 5);
      *reinterpret_cast<Quad*>(&to[j + 1][i]) = RADIANT_SHUFFLE(low01, low23, 2, 3, 6, 7);
      *reinterpret_cast<Quad*>(&to[j + 2][i]) = RADIANT_SHUFFLE(high01, high23, 0, 1, 4, 5);
      *reinterpret_cast<Quad*>(&to[j + 3][i]) = RADIANT_SHUFFLE(high01, high23, 2, 3, 6, 7);
    }
  for (int i = 0; i < 16; ++i) rows[i] = load(to[i]);
#endif
}

// out[i] = sum of all lanes of rows[i], i < kRows ≤ 16.
template <int kRows>
RADIANT_INLINE void sums_of_rows(const Part* rows, float* out) {
#if defined(__AVX512F__)
  const __m512 zero = _mm512_setzero_ps();
  __m512 r[16], a[8], b[4];
  for (int i = 0; i < 16; ++i) r[i] = i < kRows ? rows[i].p[0] : zero;
  for (int i = 0; i < 8; ++i) a[i] = _mm512_add_ps(_mm512_unpacklo_ps(r[2 * i], r[2 * i + 1]), _mm512_unpackhi_ps(r[2 * i], r[2 * i + 1]));
  for (int i = 0; i < 4; ++i) {
    const __m512d low = _mm512_castps_pd(a[2 * i]), high = _mm512_castps_pd(a[2 * i + 1]);
    b[i] = _mm512_add_ps(_mm512_castpd_ps(_mm512_unpacklo_pd(low, high)), _mm512_castpd_ps(_mm512_unpackhi_pd(low, high)));
  }
  // Rows 4i … 4i + 3 are in each quarter of b[i]: the quarters remain to be added.
  for (int i = 0; i < 2; ++i)
    a[i] = _mm512_add_ps(_mm512_shuffle_f32x4(b[2 * i], b[2 * i + 1], 0x88), _mm512_shuffle_f32x4(b[2 * i], b[2 * i + 1], 0xdd));
  const __m512 sums = _mm512_add_ps(_mm512_shuffle_f32x4(a[0], a[1], 0x88), _mm512_shuffle_f32x4(a[0], a[1], 0xdd));
  _mm512_mask_storeu_ps(out, (1u << kRows) - 1, sums);
#else
  typedef float Quad __attribute__((vector_size(16)));
  constexpr int kPadded = (kRows + 3) / 4 * 4;
  alignas(16) Quad q[kPadded];
  for (int i = 0; i < kPadded; ++i) {
    if (i >= kRows) q[i] = Quad{};
#if defined(__AVX__)
    else q[i] = (Quad)_mm_add_ps(_mm256_castps256_ps128((__m256)rows[i].p[0]), _mm256_extractf128_ps((__m256)rows[i].p[0], 1));
#else
    else q[i] = rows[i].p[0];
#endif
  }
  alignas(16) float sums[kPadded];
  for (int i = 0; i < kPadded; i += 4) {
    const Quad a = RADIANT_SHUFFLE(q[i], q[i + 1], 0, 4, 1, 5) + RADIANT_SHUFFLE(q[i], q[i + 1], 2, 6, 3, 7);
    const Quad b = RADIANT_SHUFFLE(q[i + 2], q[i + 3], 0, 4, 1, 5) + RADIANT_SHUFFLE(q[i + 2], q[i + 3], 2, 6, 3, 7);
    *reinterpret_cast<Quad*>(sums + i) = RADIANT_SHUFFLE(a, b, 0, 1, 4, 5) + RADIANT_SHUFFLE(a, b, 2, 3, 6, 7);
  }
  __builtin_memcpy(out, sums, kRows * sizeof(float));
#endif
}

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

}  // namespace radiant::RADIANT_ISA
