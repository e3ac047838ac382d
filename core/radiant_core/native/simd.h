// Sixteen float lanes on any CPU: one AVX-512 register, two AVX ones or four of 128 bits, from the same source.
//
// Included only by raster_kernels.cpp, which is compiled once per instruction set into a namespace of its own (RADIANT_ISA). Nothing
// here may come from a standard header's templates: the linker keeps one copy of those, and it might be the AVX-512 one.
#pragma once

#include <stdint.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define RADIANT_INLINE inline __attribute__((always_inline))

namespace radiant::RADIANT_ISA {

constexpr int kLanes = 16;
#if defined(__AVX512F__)
constexpr int kNative = 16;
#elif defined(__AVX__)
constexpr int kNative = 8;
#else
constexpr int kNative = 4;
#endif
constexpr int kParts = kLanes / kNative;

typedef float NativeF __attribute__((vector_size(4 * kNative)));
typedef int32_t NativeI __attribute__((vector_size(4 * kNative)));
// The same without any promise of alignment, for loads and stores.
typedef float LooseF __attribute__((vector_size(4 * kNative), aligned(4), may_alias));
typedef int32_t LooseI __attribute__((vector_size(4 * kNative), aligned(4), may_alias));

// P registers; F, I and Mask are the 16 lanes, Part is one register of them.
template <int P> struct Floats { NativeF p[P]; };
template <int P> struct Ints { NativeI p[P]; };
using F = Floats<kParts>;
using I = Ints<kParts>;
using Part = Floats<1>;
#if defined(__AVX512F__)
struct Mask { __mmask16 bits; };
#else
template <int P> struct Masks { NativeI p[P]; };
using Mask = Masks<kParts>;
#endif

#define RADIANT_EACH(P) _Pragma("GCC unroll 4") for (int i = 0; i < P; ++i)
#define RADIANT_PARTS RADIANT_EACH(kParts)

template <int P = kParts> RADIANT_INLINE Floats<P> broadcast(float x) { Floats<P> r; RADIANT_EACH(P) r.p[i] = x - NativeF{}; return r; }
template <int P = kParts> RADIANT_INLINE Ints<P> broadcast(int32_t x) { Ints<P> r; RADIANT_EACH(P) r.p[i] = x - NativeI{}; return r; }
RADIANT_INLINE F load(const float* from) { F r; RADIANT_PARTS r.p[i] = *reinterpret_cast<const LooseF*>(from + i * kNative); return r; }
RADIANT_INLINE I load(const int32_t* from) { I r; RADIANT_PARTS r.p[i] = *reinterpret_cast<const LooseI*>(from + i * kNative); return r; }
RADIANT_INLINE void store(float* to, const F& a) { RADIANT_PARTS *reinterpret_cast<LooseF*>(to + i * kNative) = a.p[i]; }
RADIANT_INLINE void store(int32_t* to, const I& a) { RADIANT_PARTS *reinterpret_cast<LooseI*>(to + i * kNative) = a.p[i]; }

template <int P> RADIANT_INLINE Floats<P> operator+(const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] + b.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> operator-(const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] - b.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> operator*(const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] * b.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> operator/(const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] / b.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> operator-(const Floats<P>& a) { Floats<P> r; RADIANT_EACH(P) r.p[i] = -a.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> operator+(const Floats<P>& a, float b) { return a + broadcast<P>(b); }
template <int P> RADIANT_INLINE Floats<P> operator-(const Floats<P>& a, float b) { return a - broadcast<P>(b); }
template <int P> RADIANT_INLINE Floats<P> operator*(const Floats<P>& a, float b) { return a * broadcast<P>(b); }
template <int P> RADIANT_INLINE Floats<P> operator*(float a, const Floats<P>& b) { return broadcast<P>(a) * b; }
template <int P> RADIANT_INLINE Floats<P> operator-(float a, const Floats<P>& b) { return broadcast<P>(a) - b; }
template <int P> RADIANT_INLINE Floats<P> operator/(float a, const Floats<P>& b) { return broadcast<P>(a) / b; }
template <int P> RADIANT_INLINE Floats<P>& operator+=(Floats<P>& a, const Floats<P>& b) { return a = a + b; }
template <int P> RADIANT_INLINE Floats<P>& operator-=(Floats<P>& a, const Floats<P>& b) { return a = a - b; }
template <int P> RADIANT_INLINE Floats<P>& operator*=(Floats<P>& a, const Floats<P>& b) { return a = a * b; }
template <int P> RADIANT_INLINE Ints<P> operator&(const Ints<P>& a, const Ints<P>& b) { Ints<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] & b.p[i]; return r; }
template <int P> RADIANT_INLINE Ints<P> operator+(const Ints<P>& a, const Ints<P>& b) { Ints<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] + b.p[i]; return r; }

#if defined(__AVX512F__)
RADIANT_INLINE Mask operator<(const F& a, const F& b) { return {_mm512_cmp_ps_mask(a.p[0], b.p[0], _CMP_LT_OQ)}; }
RADIANT_INLINE Mask operator<=(const F& a, const F& b) { return {_mm512_cmp_ps_mask(a.p[0], b.p[0], _CMP_LE_OQ)}; }
RADIANT_INLINE Mask operator<(const I& a, const I& b) { return {_mm512_cmp_epi32_mask((__m512i)a.p[0], (__m512i)b.p[0], _MM_CMPINT_LT)}; }
RADIANT_INLINE Mask operator&(Mask a, Mask b) { return {static_cast<__mmask16>(a.bits & b.bits)}; }
RADIANT_INLINE Mask operator|(Mask a, Mask b) { return {static_cast<__mmask16>(a.bits | b.bits)}; }
RADIANT_INLINE Mask operator!(Mask a) { return {static_cast<__mmask16>(~a.bits)}; }
RADIANT_INLINE F select(Mask m, const F& a, const F& b) { return {{_mm512_mask_blend_ps(m.bits, b.p[0], a.p[0])}}; }
RADIANT_INLINE I select(Mask m, const I& a, const I& b) {
  return {{(NativeI)_mm512_mask_blend_epi32(m.bits, (__m512i)b.p[0], (__m512i)a.p[0])}};
}
// a where m, 0 elsewhere.
RADIANT_INLINE F keep(Mask m, const F& a) { return {{_mm512_maskz_mov_ps(m.bits, a.p[0])}}; }
RADIANT_INLINE uint32_t bits_of(Mask m) { return m.bits; }
RADIANT_INLINE Mask mask_of(uint32_t bits) { return {static_cast<__mmask16>(bits)}; }
RADIANT_INLINE F min(const F& a, const F& b) { return {{_mm512_min_ps(a.p[0], b.p[0])}}; }
RADIANT_INLINE F max(const F& a, const F& b) { return {{_mm512_max_ps(a.p[0], b.p[0])}}; }
RADIANT_INLINE F sqrt(const F& a) { return {{_mm512_sqrt_ps(a.p[0])}}; }
// 1/a to 2⁻²³: the CPU's 14-bit estimate and one Newton step.
RADIANT_INLINE F reciprocal(const F& a) {
  const F r{{_mm512_rcp14_ps(a.p[0])}};
  return r + r * (1.0f - a * r);
}
#else
template <int P> RADIANT_INLINE Masks<P> operator<(const Floats<P>& a, const Floats<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] < b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator<=(const Floats<P>& a, const Floats<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] <= b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator<(const Ints<P>& a, const Ints<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] < b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator&(const Masks<P>& a, const Masks<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] & b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator|(const Masks<P>& a, const Masks<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] | b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator!(const Masks<P>& a) { Masks<P> r; RADIANT_EACH(P) r.p[i] = ~a.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> select(const Masks<P>& m, const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = m.p[i] ? a.p[i] : b.p[i]; return r; }
template <int P> RADIANT_INLINE Ints<P> select(const Masks<P>& m, const Ints<P>& a, const Ints<P>& b) { Ints<P> r; RADIANT_EACH(P) r.p[i] = m.p[i] ? a.p[i] : b.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> keep(const Masks<P>& m, const Floats<P>& a) { Floats<P> r; RADIANT_EACH(P) r.p[i] = (NativeF)(m.p[i] & (NativeI)a.p[i]); return r; }
RADIANT_INLINE uint32_t bits_of(const Mask& m) {
  uint32_t bits = 0;
#if defined(__AVX__)
  RADIANT_PARTS bits |= static_cast<uint32_t>(_mm256_movemask_ps((__m256)m.p[i])) << (8 * i);
#elif defined(__SSE2__)
  RADIANT_PARTS bits |= static_cast<uint32_t>(_mm_movemask_ps((__m128)m.p[i])) << (4 * i);
#else
  RADIANT_PARTS for (int j = 0; j < kNative; ++j) bits |= static_cast<uint32_t>(m.p[i][j] & 1) << (kNative * i + j);
#endif
  return bits;
}
RADIANT_INLINE Mask mask_of(uint32_t bits) {
  Mask r;
  RADIANT_PARTS for (int j = 0; j < kNative; ++j) r.p[i][j] = -static_cast<int32_t>(bits >> (kNative * i + j) & 1);
  return r;
}
template <int P> RADIANT_INLINE Floats<P> min(const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] < b.p[i] ? a.p[i] : b.p[i]; return r; }
template <int P> RADIANT_INLINE Floats<P> max(const Floats<P>& a, const Floats<P>& b) { Floats<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] > b.p[i] ? a.p[i] : b.p[i]; return r; }
RADIANT_INLINE F sqrt(const F& a) {
  F r;
#if defined(__AVX__)
  RADIANT_PARTS r.p[i] = (NativeF)_mm256_sqrt_ps((__m256)a.p[i]);
#elif defined(__SSE2__)
  RADIANT_PARTS r.p[i] = (NativeF)_mm_sqrt_ps((__m128)a.p[i]);
#else
  RADIANT_PARTS for (int j = 0; j < kNative; ++j) r.p[i][j] = __builtin_sqrtf(a.p[i][j]);
#endif
  return r;
}
template <int P> RADIANT_INLINE Floats<P> reciprocal(const Floats<P>& a) {
#if defined(__AVX__)
  Floats<P> r;
  RADIANT_EACH(P) r.p[i] = (NativeF)_mm256_rcp_ps((__m256)a.p[i]);
  // The estimate has 12 bits. A plain Newton step leaves −1e-7, always of one sign: in a product of 40 factors, 5e-6.
  const Floats<P> miss = 1.0f - a * r;
  return r + r * (miss + miss * miss);
#else
  return 1.0f / a;
#endif
}
#endif

template <int P> RADIANT_INLINE auto operator>(const Floats<P>& a, const Floats<P>& b) { return b < a; }
template <int P> RADIANT_INLINE auto operator>=(const Floats<P>& a, const Floats<P>& b) { return b <= a; }
template <int P> RADIANT_INLINE Floats<P> clamp(const Floats<P>& a, const Floats<P>& low, const Floats<P>& high) { return max(low, min(a, high)); }
template <int P> RADIANT_INLINE Floats<P> abs(const Floats<P>& a) { Floats<P> r; RADIANT_EACH(P) r.p[i] = (NativeF)((NativeI)a.p[i] & 0x7fffffff); return r; }
template <int P> RADIANT_INLINE Ints<P> truncated(const Floats<P>& a) { Ints<P> r; RADIANT_EACH(P) r.p[i] = __builtin_convertvector(a.p[i], NativeI); return r; }
template <int P> RADIANT_INLINE Floats<P> as_float(const Ints<P>& a) { Floats<P> r; RADIANT_EACH(P) r.p[i] = __builtin_convertvector(a.p[i], NativeF); return r; }
RADIANT_INLINE Part part(const F& a, int i) { return {{a.p[i]}}; }
RADIANT_INLINE Mask all_lanes() { return mask_of(0xffff); }

template <int P> RADIANT_INLINE Floats<P> operator+(float a, const Floats<P>& b) { return broadcast<P>(a) + b; }

// 2ᵗ for t ≤ 0, to 9e-8 or else to 2.6e-6, by the polynomial of 2ᶠ on 0 ≤ f < 1 with the least maximal relative error.
// Far below −126 the result is 0 or next to it.
template <bool kPrecise, int P>
RADIANT_INLINE Floats<P> exp2_of_negative(const Floats<P>& t) {
  constexpr float c4[] = {1.0000026226043701f, 0.6930038332939148f, 0.2414427548646927f, 0.05201146379113197f, 0.013534167781472206f, 0.0f};
  constexpr float c5[] = {0.9999999403953552f,  0.6931530833244324f,   0.24015361070632935f,
                          0.05582631751894951f, 0.008989340625703335f, 0.0018775766948238015f};
  const float* c = kPrecise ? c5 : c4;
#if defined(__AVX512DQ__)
  const Floats<P> f{{_mm512_reduce_ps(t.p[0], _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC)}};
#else
  const Floats<P> bounded = max(t, broadcast<P>(-126.0f));
  const Ints<P> whole = truncated(bounded) + broadcast<P>(int32_t{-1});
  const Floats<P> f = bounded - as_float(whole);
#endif
  Floats<P> power = kPrecise ? broadcast<P>(c[4]) + f * c[5] : broadcast<P>(c[4]);
  power = c[0] + f * (c[1] + f * (c[2] + f * (c[3] + f * power)));
#if defined(__AVX512DQ__)
  return {{_mm512_scalef_ps(power.p[0], t.p[0])}};
#else
  Floats<P> r;
  RADIANT_EACH(P) r.p[i] = (NativeF)((NativeI)power.p[i] + (whole.p[i] << 23));
  return r;
#endif
}

// eˣ for any x, to a few 2⁻²⁴; infinite above 88.7, 0 below −87.
RADIANT_INLINE F exp(const F& x) {
  const F limited = clamp(x, broadcast(-89.0f), broadcast(89.0f));
  F r;
  F scaled = limited * 1.44269504f;
  I whole;
  RADIANT_PARTS whole.p[i] = __builtin_convertvector(scaled.p[i] + 128.0f, NativeI) - 128;
  // One fused multiply-add, so that the fraction keeps the bits that the product alone would lose.
  const F f = limited * 1.44269504f - as_float(whole);
  const F power = 1.0f + f * (0.6931470036506653f + f * (0.24022983014583588f + f * (0.055483341217041016f +
                  f * (0.009678840637207031f + f * (0.0012439688434824347f + f * 0.00021702254889532924f)))));
  RADIANT_PARTS {
    // Two steps of half the exponent each, so that neither leaves the range of the other.
    const NativeI half = whole.p[i] >> 1, rest = whole.p[i] - half;
    r.p[i] = power.p[i] * (NativeF)((half + 127) << 23) * (NativeF)((rest + 127) << 23);
  }
  return r;
}

// log₂ of a normal positive number, to 1e-7: log₂ m = 2/ln 2 · artanh((m−1)/(m+1)) with m in [√½, √2).
RADIANT_INLINE F log2(const F& x) {
  F mantissa, exponent;
  RADIANT_PARTS {
    const NativeI bits = (NativeI)x.p[i];
    const NativeI shift = (bits - 0x3f3504f3) >> 23;
    exponent.p[i] = __builtin_convertvector(shift, NativeF);
    mantissa.p[i] = (NativeF)(bits - (shift << 23));
  }
  const F s = (mantissa - 1.0f) / (mantissa + 1.0f), q = s * s;
  return exponent + s * (2.8853900817779268f + q * (0.9617966939259756f + q * (0.5770780163555854f + q * (0.4121985831111324f + q * 0.3205988979753252f))));
}

// Turns 16 rows of 16 into 16 columns.
RADIANT_INLINE void transpose(F rows[kLanes]) {
#if defined(__AVX512F__)
  // Unrolled by hand of the pragma: left as loops, gcc keeps the arrays in memory, at five times the cost.
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
  typedef int32_t Pick __attribute__((vector_size(16)));
  alignas(64) float from[16][16], to[16][16];
  for (int i = 0; i < 16; ++i) store(from[i], rows[i]);
  for (int i = 0; i < 16; i += 4)
    for (int j = 0; j < 16; j += 4) {
      const Quad r0 = *reinterpret_cast<Quad*>(&from[i][j]), r1 = *reinterpret_cast<Quad*>(&from[i + 1][j]);
      const Quad r2 = *reinterpret_cast<Quad*>(&from[i + 2][j]), r3 = *reinterpret_cast<Quad*>(&from[i + 3][j]);
      const Quad low01 = __builtin_shuffle(r0, r1, Pick{0, 4, 1, 5}), high01 = __builtin_shuffle(r0, r1, Pick{2, 6, 3, 7});
      const Quad low23 = __builtin_shuffle(r2, r3, Pick{0, 4, 1, 5}), high23 = __builtin_shuffle(r2, r3, Pick{2, 6, 3, 7});
      *reinterpret_cast<Quad*>(&to[j][i]) = __builtin_shuffle(low01, low23, Pick{0, 1, 4, 5});
      *reinterpret_cast<Quad*>(&to[j + 1][i]) = __builtin_shuffle(low01, low23, Pick{2, 3, 6, 7});
      *reinterpret_cast<Quad*>(&to[j + 2][i]) = __builtin_shuffle(high01, high23, Pick{0, 1, 4, 5});
      *reinterpret_cast<Quad*>(&to[j + 3][i]) = __builtin_shuffle(high01, high23, Pick{2, 3, 6, 7});
    }
  for (int i = 0; i < 16; ++i) rows[i] = load(to[i]);
#endif
}

// out[i] = sum of all lanes of rows[i], i < kRows ≤ 12.
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
  // Rows 4i … 4i + 3 stand in each quarter of b[i]: what is left is to add the quarters.
  for (int i = 0; i < 2; ++i)
    a[i] = _mm512_add_ps(_mm512_shuffle_f32x4(b[2 * i], b[2 * i + 1], 0x88), _mm512_shuffle_f32x4(b[2 * i], b[2 * i + 1], 0xdd));
  const __m512 sums = _mm512_add_ps(_mm512_shuffle_f32x4(a[0], a[1], 0x88), _mm512_shuffle_f32x4(a[0], a[1], 0xdd));
  _mm512_mask_storeu_ps(out, (1u << kRows) - 1, sums);
#else
  typedef float Quad __attribute__((vector_size(16)));
  typedef int32_t Pick __attribute__((vector_size(16)));
  alignas(16) Quad q[12];
  for (int i = 0; i < 12; ++i) {
    if (i >= kRows) q[i] = Quad{};
#if defined(__AVX__)
    else q[i] = (Quad)_mm_add_ps(_mm256_castps256_ps128((__m256)rows[i].p[0]), _mm256_extractf128_ps((__m256)rows[i].p[0], 1));
#else
    else q[i] = rows[i].p[0];
#endif
  }
  alignas(16) float sums[12];
  for (int i = 0; i < 12; i += 4) {
    const Quad a = __builtin_shuffle(q[i], q[i + 1], Pick{0, 4, 1, 5}) + __builtin_shuffle(q[i], q[i + 1], Pick{2, 6, 3, 7});
    const Quad b = __builtin_shuffle(q[i + 2], q[i + 3], Pick{0, 4, 1, 5}) + __builtin_shuffle(q[i + 2], q[i + 3], Pick{2, 6, 3, 7});
    *reinterpret_cast<Quad*>(sums + i) = __builtin_shuffle(a, b, Pick{0, 1, 4, 5}) + __builtin_shuffle(a, b, Pick{2, 3, 6, 7});
  }
  __builtin_memcpy(out, sums, kRows * sizeof(float));
#endif
}

// To 64 aligned bytes, past the caches: the line is not read first, and what is in the caches stays there.
RADIANT_INLINE void stream(float* to, const F& a) {
#if defined(__AVX512F__)
  _mm512_stream_ps(to, a.p[0]);
#elif defined(__AVX__)
  RADIANT_PARTS _mm256_stream_ps(to + i * kNative, (__m256)a.p[i]);
#elif defined(__SSE2__)
  RADIANT_PARTS _mm_stream_ps(to + i * kNative, (__m128)a.p[i]);
#else
  store(to, a);
#endif
}

// Waits until what was streamed can be seen by other threads.
RADIANT_INLINE void finish_streams() {
#if defined(__SSE2__)
  _mm_sfence();
#endif
}

}  // namespace radiant::RADIANT_ISA
