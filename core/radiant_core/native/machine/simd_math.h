// Powers and logarithms of 16 lanes, without branches.
#pragma once

#include "machine/simd.h"

namespace radiant::RADIANT_ISA {

// 2ᵗ for t ≤ 0, to 9e-8, by the minimax polynomial of 2ᶠ on 0 ≤ f < 1; about 0 far below −126.
template <int P>
RADIANT_INLINE Floats<P> exp2_of_negative(const Floats<P>& t) {
  constexpr float c[] = {0.9999999403953552f,  0.6931530833244324f,   0.24015361070632935f,
                         0.05582631751894951f, 0.008989340625703335f, 0.0018775766948238015f};
#if defined(__AVX512F__)
  // Not `vreduceps`, which rounds the difference down too.
  const Floats<P> f = t - Floats<P>{{_mm512_roundscale_ps(t.p[0], _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC)}};
#else
  const Floats<P> bounded = max(t, broadcast<P>(-126.0f));
  // ⌊t⌋: a comparison is −1 where the whole part towards 0 is above it.
  Ints<P> whole = truncated(bounded);
  const Floats<P> nearer = as_float(whole);
  RADIANT_EACH(P) whole.p[i] += bounded.p[i] < nearer.p[i];
  const Floats<P> f = bounded - as_float(whole);
#endif
  const Floats<P> power = fma(f, fma(f, fma(f, fma(f, fma(f, broadcast<P>(c[5]), c[4]), c[3]), c[2]), c[1]), c[0]);
#if defined(__AVX512F__)
  return {{_mm512_scalef_ps(power.p[0], t.p[0])}};
#else
  Floats<P> r;
  RADIANT_EACH(P) r.p[i] = (NativeF)((NativeI)power.p[i] + (whole.p[i] << 23));
  return r;
#endif
}

// eˣ for any x, to a few 2⁻²⁴; held at e^±89 beyond: 4e38 is infinite, 2e-39 denormal or 0.
RADIANT_INLINE F exp(const F& x) {
  const F limited = clamp(x, broadcast(-89.0f), broadcast(89.0f));
  F r;
  F scaled = limited * 1.44269504f;
  I whole;
  RADIANT_PARTS whole.p[i] = __builtin_convertvector(scaled.p[i] + 128.0f, NativeI) - 128;
  // One fused multiply-add, so that the fraction keeps the bits that the product alone would lose.
  const F f = fma(1.44269504f, limited, -as_float(whole));
  const F high = fma(f, fma(f, broadcast(0.00021702254889532924f), 0.0012439688434824347f), 0.009678840637207031f);
  const F power = fma(f, fma(f, fma(f, fma(f, high, 0.055483341217041016f), 0.24022983014583588f), 0.6931470036506653f), 1.0f);
  RADIANT_PARTS {
    // Two steps of half the exponent each, so that neither leaves the range of the other.
    const NativeI half = whole.p[i] >> 1, rest = whole.p[i] - half;
    r.p[i] = power.p[i] * (NativeF)((half + 127) << 23) * (NativeF)((rest + 127) << 23);
  }
  return r;
}

// log₂ of a normal positive number, to 1e-7: log₂ m = 2/ln 2 · artanh((m−1)/(m+1)), m ∈ [√½, √2).
RADIANT_INLINE F log2(const F& x) {
  F mantissa, exponent;
  RADIANT_PARTS {
    const NativeI bits = (NativeI)x.p[i];
    const NativeI shift = (bits - 0x3f3504f3) >> 23;
    exponent.p[i] = __builtin_convertvector(shift, NativeF);
    mantissa.p[i] = (NativeF)(bits - (shift << 23));
  }
  const F s = (mantissa - 1.0f) / (mantissa + 1.0f), q = s * s;
  const F series = fma(q, fma(q, fma(q, broadcast(0.3205988979753252f), 0.4121985831111324f), 0.5770780163555854f), 0.9617966939259756f);
  return fma(s, fma(q, series, 2.8853900817779268f), exponent);
}

}  // namespace radiant::RADIANT_ISA
