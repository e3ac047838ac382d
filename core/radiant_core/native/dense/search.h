// PatchMatch over a lattice of nodes (Barnes 2009; Bleyer 2011 for slanted planes), 16 at once.
//
// A pass gives every node the cheapest of its own plane, those of nodes around it continued to
// here, and three random changes of the best: of w, of the slopes, of both. Every node reads the
// planes of the pass before, so that neither the order nor the number of threads matters; random
// numbers are hashes of node and pass. Included only by dense/kernels.cpp.
#pragma once

namespace radiant::RADIANT_ISA {

typedef uint32_t NativeU __attribute__((vector_size(4 * kNative)));

// Uniform in -1..1, of two counters (a hash with full avalanche: multiply, shift, xor).
RADIANT_INLINE F noise(uint32_t node, uint32_t counter) {
  F r;
  RADIANT_PARTS {
    NativeU h;
    for (int j = 0; j < kNative; ++j) h[j] = node + static_cast<uint32_t>(i * kNative + j);
    h = h * 0x9e3779b9u + counter;
    h = (h ^ (h >> 16)) * 0x7feb352du;
    h = (h ^ (h >> 15)) * 0x846ca68bu;
    h ^= h >> 16;
    r.p[i] = __builtin_convertvector((NativeI)(h >> 8), NativeF) * (2.0f / 16777216.0f) - 1.0f;
  }
  return r;
}

struct Best {
  F w, a, b, cost;
};

RADIANT_INLINE void compete(const DepthJob& job, const Window& window, const F& w, const F& a, const F& b, Best& best) {
  const F cost = plane_cost(job, window, w, a, b);
  const Mask better = cost < best.cost;
  best.w = select(better, w, best.w);
  best.a = select(better, a, best.a);
  best.b = select(better, b, best.b);
  best.cost = select(better, cost, best.cost);
}

RADIANT_INLINE Best loaded(const PlaneRows& rows, int64_t at) {
  return {load(rows.inverse_depths + at), load(rows.across + at), load(rows.down + at), load(rows.costs + at)};
}

RADIANT_INLINE void stored(const PlaneRows& rows, int64_t at, const Best& best) {
  store(rows.inverse_depths + at, best.w);
  store(rows.across + at, best.a);
  store(rows.down + at, best.b);
  store(rows.costs + at, best.cost);
}

inline void try_rows(const DepthJob& job, const float* candidates, int64_t begin, int64_t end) {
  const int64_t plane = job.rows * job.stride;
  Window window;
  for (int64_t row = begin; row < end; ++row)
    for (int64_t column = 0; column < job.columns; column += kLanes) {
      const int64_t at = row * job.stride + column;
      look(job, row, column, window);
      Best best = loaded(job.to, at);
      compete(job, window, load(candidates + at), load(candidates + plane + at), load(candidates + 2 * plane + at), best);
      stored(job.to, at, best);
    }
}

inline void pass_rows(const DepthJob& job, const DepthPass& pass, int64_t begin, int64_t end) {
  Window window;
  for (int64_t row = begin; row < end; ++row)
    for (int64_t column = 0; column < job.columns; column += kLanes) {
      const int64_t at = row * job.stride + column;
      look(job, row, column, window);
      Best best = loaded(job.from, at);
      for (int ring = 0; ring < (pass.reach > 0 ? 2 : 1); ++ring) {
        const int64_t distance = ring ? pass.reach : 1;
        for (int side = 0; side < 4; ++side) {
          const int64_t down = side < 2 ? 0 : side == 2 ? -distance : distance;
          const int64_t right = side > 1 ? 0 : side == 0 ? -distance : distance;
          // Rows end in padding, so only whole rows may be missing; padding has w = 0 and costs 2.
          if (row + down < 0 || row + down >= job.rows) continue;
          const int64_t there = at + down * job.stride + right;
          const F a = load(job.from.across + there), b = load(job.from.down + there);
          const F w = load(job.from.inverse_depths + there) - job.step * (static_cast<float>(right) * a + static_cast<float>(down) * b);
          compete(job, window, w, a, b, best);
        }
      }
      const uint32_t node = static_cast<uint32_t>(row * job.columns + column);
      const float size = pass.amplitude_px * job.pixel, slope = size / kRadiusPx;
      for (uint32_t kind = 0; kind < 3 && pass.amplitude_px > 0; ++kind) {
        const uint32_t counter = pass.seed + 3 * kind;
        const F w = kind == 1 ? best.w : best.w + size * noise(node, counter);
        const F a = kind == 0 ? best.a : best.a + slope * noise(node, counter + 1);
        const F b = kind == 0 ? best.b : best.b + slope * noise(node, counter + 2);
        compete(job, window, w, a, b, best);
      }
      stored(job.to, at, best);
    }
}

}  // namespace radiant::RADIANT_ISA
