// Sixteen float lanes on any CPU: one AVX-512 register, two AVX ones or four of 128 bits.
//
// Included only by raster/kernels.cpp and dense/kernels.cpp, which are compiled once per
// instruction set into its own namespace (RADIANT_ISA). Nothing here may come from a standard
// header's templates: the linker keeps one copy of those, and it might be the AVX-512 one.
#pragma once

#include <stddef.h>
#include <stdint.h>
#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#define RADIANT_INLINE inline __attribute__((always_inline))
// Elements of two vectors of four, those of the second counted from 4.
#if defined(__clang__) || __GNUC__ >= 12
#define RADIANT_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define RADIANT_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, int32_t __attribute__((vector_size(16))){__VA_ARGS__})
#endif

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
template <int P> RADIANT_INLINE Floats<P> operator+(float a, const Floats<P>& b) { return broadcast<P>(a) + b; }
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

// a b + c and c − a b, rounded once where the CPU has such an instruction. Written out, not left to
// the compiler, in what decides about pixels: so AVX-512, AVX2 and arm64 agree to the last bit.
// SSE2 has none and rounds twice.
template <int P> RADIANT_INLINE Floats<P> fma(const Floats<P>& a, const Floats<P>& b, const Floats<P>& c) {
  Floats<P> r;
#if defined(__AVX512F__)
  RADIANT_EACH(P) r.p[i] = (NativeF)_mm512_fmadd_ps((__m512)a.p[i], (__m512)b.p[i], (__m512)c.p[i]);
#elif defined(__FMA__)
  RADIANT_EACH(P) r.p[i] = (NativeF)_mm256_fmadd_ps((__m256)a.p[i], (__m256)b.p[i], (__m256)c.p[i]);
#elif defined(__aarch64__)
  RADIANT_EACH(P) r.p[i] = (NativeF)vfmaq_f32((float32x4_t)c.p[i], (float32x4_t)a.p[i], (float32x4_t)b.p[i]);
#else
  RADIANT_EACH(P) r.p[i] = a.p[i] * b.p[i] + c.p[i];
#endif
  return r;
}
template <int P> RADIANT_INLINE Floats<P> fnma(const Floats<P>& a, const Floats<P>& b, const Floats<P>& c) {
  Floats<P> r;
#if defined(__AVX512F__)
  RADIANT_EACH(P) r.p[i] = (NativeF)_mm512_fnmadd_ps((__m512)a.p[i], (__m512)b.p[i], (__m512)c.p[i]);
#elif defined(__FMA__)
  RADIANT_EACH(P) r.p[i] = (NativeF)_mm256_fnmadd_ps((__m256)a.p[i], (__m256)b.p[i], (__m256)c.p[i]);
#elif defined(__aarch64__)
  RADIANT_EACH(P) r.p[i] = (NativeF)vfmsq_f32((float32x4_t)c.p[i], (float32x4_t)a.p[i], (float32x4_t)b.p[i]);
#else
  RADIANT_EACH(P) r.p[i] = c.p[i] - a.p[i] * b.p[i];
#endif
  return r;
}
template <int P> RADIANT_INLINE Floats<P> fma(float a, const Floats<P>& b, const Floats<P>& c) { return fma(broadcast<P>(a), b, c); }
template <int P> RADIANT_INLINE Floats<P> fma(const Floats<P>& a, const Floats<P>& b, float c) { return fma(a, b, broadcast<P>(c)); }
// Σ a b of three.
template <int P>
RADIANT_INLINE Floats<P> dot(const Floats<P>& a0, const Floats<P>& b0, const Floats<P>& a1, const Floats<P>& b1, const Floats<P>& a2, const Floats<P>& b2) {
  return fma(a0, b0, fma(a1, b1, a2 * b2));
}
template <int P> RADIANT_INLINE Floats<P> fma(float a, const Floats<P>& b, float c) { return fma(broadcast<P>(a), b, broadcast<P>(c)); }

#if defined(__AVX512F__)
RADIANT_INLINE Mask operator<(const F& a, const F& b) { return {_mm512_cmp_ps_mask(a.p[0], b.p[0], _CMP_LT_OQ)}; }
RADIANT_INLINE Mask operator<=(const F& a, const F& b) { return {_mm512_cmp_ps_mask(a.p[0], b.p[0], _CMP_LE_OQ)}; }
RADIANT_INLINE Mask operator<(const I& a, const I& b) { return {_mm512_cmp_epi32_mask((__m512i)a.p[0], (__m512i)b.p[0], _MM_CMPINT_LT)}; }
RADIANT_INLINE Mask operator&(Mask a, Mask b) { return {static_cast<__mmask16>(a.bits & b.bits)}; }
RADIANT_INLINE Mask operator|(Mask a, Mask b) { return {static_cast<__mmask16>(a.bits | b.bits)}; }
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
  return fma(r, fnma(a, r, broadcast(1.0f)), r);
}
#else
template <int P> RADIANT_INLINE Masks<P> operator<(const Floats<P>& a, const Floats<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] < b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator<=(const Floats<P>& a, const Floats<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] <= b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator<(const Ints<P>& a, const Ints<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] < b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator&(const Masks<P>& a, const Masks<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] & b.p[i]; return r; }
template <int P> RADIANT_INLINE Masks<P> operator|(const Masks<P>& a, const Masks<P>& b) { Masks<P> r; RADIANT_EACH(P) r.p[i] = a.p[i] | b.p[i]; return r; }
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
  // The estimate has 12 bits. A plain Newton step leaves −1e-7, always of one sign: in a product of
  // 40 factors, 5e-6.
  const Floats<P> miss = fnma(a, r, broadcast<P>(1.0f));
  return fma(r, fma(miss, miss, miss), r);
#else
  return 1.0f / a;
#endif
}
#endif

template <int P> RADIANT_INLINE Floats<P> clamp(const Floats<P>& a, const Floats<P>& low, const Floats<P>& high) { return max(low, min(a, high)); }
template <int P> RADIANT_INLINE Floats<P> abs(const Floats<P>& a) { Floats<P> r; RADIANT_EACH(P) r.p[i] = (NativeF)((NativeI)a.p[i] & 0x7fffffff); return r; }
template <int P> RADIANT_INLINE Ints<P> truncated(const Floats<P>& a) { Ints<P> r; RADIANT_EACH(P) r.p[i] = __builtin_convertvector(a.p[i], NativeI); return r; }
template <int P> RADIANT_INLINE Floats<P> as_float(const Ints<P>& a) { Floats<P> r; RADIANT_EACH(P) r.p[i] = __builtin_convertvector(a.p[i], NativeF); return r; }
RADIANT_INLINE Part part(const F& a, int i) { return {{a.p[i]}}; }

// To 64 aligned bytes, past the caches: the line is not read first, the caches keep what they hold.
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
