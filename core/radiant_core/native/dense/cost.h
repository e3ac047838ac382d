// How well a plane of inverse depth explains what neighbouring photographs show at 16 nodes.
//
// A window of 32 pixels i around the node, in a chequer of 2 px, has grey values I_i and weights
//   w_i = exp(-|I_i - I_c| / 16) / sum          pixels of another colour are of another surface
// and a source's grey values J_i at their projections, bilinear, by the plane's affine map there:
//   NCC = sum w (I - mean I) J / sqrt(var_w I  var_w J),  cost of a source = 1 - NCC in 0..2
// The plane costs the mean of its two best sources, so that one of them may be hidden. What lies
// outside a source, behind it, or has no contrast costs 2. Most of the time is spent here, once per
// node, candidate, source and pixel. Included only by dense/kernels.cpp.
#pragma once

namespace radiant::RADIANT_ISA {

constexpr int kSamples = 32;
constexpr float kRadiusPx = 7.0f, kSimilarGrey = 16.0f, kWorst = 2.0f;
// Variance of grey below which a window says nothing: noise of one step has about 1.
constexpr float kLeastVariance = 2.0f;

// The pixel of the window: rows of 4, two pixels apart, every other row shifted by half of that.
RADIANT_INLINE float sample_x(int i) { return static_cast<float>(4 * (i % 4) - 7 + 2 * ((i / 4) % 2)); }
RADIANT_INLINE float sample_y(int i) { return static_cast<float>(2 * (i / 4) - 7); }

RADIANT_INLINE I gather(const uint32_t* from, const I& at) {
  I r;
#if defined(__AVX512F__)
  r.p[0] = (NativeI)_mm512_i32gather_epi32((__m512i)at.p[0], from, 4);
#elif defined(__AVX2__)
  RADIANT_PARTS r.p[i] = (NativeI)_mm256_i32gather_epi32(reinterpret_cast<const int*>(from), (__m256i)at.p[i], 4);
#else
  RADIANT_PARTS for (int j = 0; j < kNative; ++j) r.p[i][j] = static_cast<int32_t>(from[at.p[i][j]]);
#endif
  return r;
}

RADIANT_INLINE F byte_of(const I& packed, int index) {
  I r;
  RADIANT_PARTS r.p[i] = (packed.p[i] >> (8 * index)) & 0xff;
  return as_float(r);
}

// Sixteen nodes with the window of each: weights and weighted, normed differences to the mean.
struct Window {
  F x, y;
  Mask textured;
  alignas(64) float weights[kSamples][kLanes];
  alignas(64) float shares[kSamples][kLanes];
};

inline float grey_at(const DepthJob& job, int x, int y) {
  x = x < 0 ? 0 : x >= job.width ? job.width - 1 : x;
  y = y < 0 ? 0 : y >= job.height ? job.height - 1 : y;
  return job.reference[static_cast<int64_t>(y) * job.width + x];
}

inline void look(const DepthJob& job, int64_t row, int64_t column, Window& window) {
  alignas(64) float grey[kSamples][kLanes], middle[kLanes], xs[kLanes];
  const float y = job.first + job.step * static_cast<float>(row);
  for (int lane = 0; lane < kLanes; ++lane) {
    xs[lane] = job.first + job.step * static_cast<float>(column + lane);
    const int px = static_cast<int>(xs[lane]), py = static_cast<int>(y);
    middle[lane] = grey_at(job, px, py);
    for (int i = 0; i < kSamples; ++i) grey[i][lane] = grey_at(job, px + static_cast<int>(sample_x(i)), py + static_cast<int>(sample_y(i)));
  }
  window.x = load(xs);
  window.y = broadcast(y);
  const F center = load(middle);
  F total = broadcast(0.0f), mean = broadcast(0.0f), square = broadcast(0.0f);
  for (int i = 0; i < kSamples; ++i) {
    const F value = load(grey[i]) - center;
    const F weight = exp(-abs(value) * (1.0f / kSimilarGrey));
    store(window.weights[i], weight);
    total += weight;
    mean += weight * value;
    square += weight * value * value;
  }
  const F share = 1.0f / total;
  mean = mean * share;
  const F variance = square * share - mean * mean;
  window.textured = broadcast(kLeastVariance) < variance;
  const F norm = share / sqrt(max(variance, broadcast(kLeastVariance)));
  for (int i = 0; i < kSamples; ++i) {
    const F weight = load(window.weights[i]);
    store(window.shares[i], weight * norm * (load(grey[i]) - center - mean));
    store(window.weights[i], weight * share);
  }
}

// Where the window lies in one source: its middle and the two columns of the affine map there.
struct Footprint {
  F u, v, ux, uy, vx, vy;
  Mask inside;
};

RADIANT_INLINE Footprint project(const Window& window, const DepthSource& source, const F& w, const F& a, const F& b) {
  const float* m = source.matrix;
  const float* t = source.offset;
  const F z = m[6] * window.x + m[7] * window.y + m[8] + t[2] * w;
  const F inverse = 1.0f / z;
  Footprint at;
  at.u = (m[0] * window.x + m[1] * window.y + m[2] + t[0] * w) * inverse;
  at.v = (m[3] * window.x + m[4] * window.y + m[5] + t[1] * w) * inverse;
  const F zx = m[6] + t[2] * a, zy = m[7] + t[2] * b;
  at.ux = (m[0] + t[0] * a - at.u * zx) * inverse;
  at.uy = (m[1] + t[0] * b - at.u * zy) * inverse;
  at.vx = (m[3] + t[1] * a - at.v * zx) * inverse;
  at.vy = (m[4] + t[1] * b - at.v * zy) * inverse;
  const F across = (abs(at.ux) + abs(at.uy)) * kRadiusPx, along = (abs(at.vx) + abs(at.vy)) * kRadiusPx;
  const F right = broadcast(static_cast<float>(source.width) - 2.0f), bottom = broadcast(static_cast<float>(source.height) - 2.0f);
  const F zero = broadcast(0.0f);
  at.inside = (zero < z) & (across <= at.u) & (along <= at.v) & (at.u + across < right) & (at.v + along < bottom);
  return at;
}

RADIANT_INLINE F source_cost(const Window& window, const DepthSource& source, const F& w, const F& a, const F& b) {
  const Footprint at = project(window, source, w, a, b);
  if (bits_of(at.inside) == 0) return broadcast(kWorst);
  const float width = static_cast<float>(source.width);
  const F zero = broadcast(0.0f), right = broadcast(width - 2.0f), bottom = broadcast(static_cast<float>(source.height) - 2.0f);
  F sum = zero, square = zero, product = zero;
  for (int i = 0; i < kSamples; ++i) {
    const F u = clamp(at.u + sample_x(i) * at.ux + sample_y(i) * at.uy, zero, right);
    const F v = clamp(at.v + sample_x(i) * at.vx + sample_y(i) * at.vy, zero, bottom);
    const F left = as_float(truncated(u)), top = as_float(truncated(v));
    // Exact: a photograph of 2^24 pixels is refused.
    const I packed = gather(source.quads, truncated(top * width + left));
    const F right_share = u - left, lower_share = v - top;
    const F upper_left = byte_of(packed, 0), lower_left = byte_of(packed, 2);
    const F upper = upper_left + right_share * (byte_of(packed, 1) - upper_left);
    const F lower = lower_left + right_share * (byte_of(packed, 3) - lower_left);
    // Grey from -128 on, whose squares keep more digits.
    const F value = upper + lower_share * (lower - upper) - 128.0f;
    const F weighted = load(window.weights[i]) * value;
    sum += weighted;
    square += weighted * value;
    product += load(window.shares[i]) * value;
  }
  const F variance = square - sum * sum;
  const Mask counts = at.inside & (broadcast(kLeastVariance) < variance);
  const F cost = 1.0f - product / sqrt(max(variance, broadcast(kLeastVariance)));
  return select(counts, clamp(cost, zero, broadcast(kWorst)), broadcast(kWorst));
}

RADIANT_INLINE F plane_cost(const DepthJob& job, const Window& window, const F& w, const F& a, const F& b) {
  // The plane's normal in the camera is (a fx, b fy, w - a (x - cx) - b (y - cy)).
  const F rx = (window.x - job.center_x) * (1.0f / job.focal_x), ry = (window.y - job.center_y) * (1.0f / job.focal_y);
  const F nx = a * job.focal_x, ny = b * job.focal_y, nz = w - nx * rx - ny * ry;
  const F lengths = (nx * nx + ny * ny + nz * nz) * (rx * rx + ry * ry + 1.0f);
  const Mask valid = (broadcast(job.least) <= w) & (w <= broadcast(job.most)) & (job.min_cosine * job.min_cosine * lengths <= w * w);
  if (bits_of(valid & window.textured) == 0) return broadcast(kWorst);
  F best = broadcast(kWorst), second = broadcast(kWorst);
  for (int k = 0; k < job.num_sources; ++k) {
    const F cost = source_cost(window, job.sources[k], w, a, b);
    second = min(second, max(best, cost));
    best = min(best, cost);
  }
  return select(valid & window.textured, job.num_sources > 1 ? 0.5f * (best + second) : best, broadcast(kWorst));
}

}  // namespace radiant::RADIANT_ISA
