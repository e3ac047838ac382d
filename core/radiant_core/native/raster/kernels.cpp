// The rasterizer's kernels for one instruction set: compiled per RADIANT_ISA and flags.
#include "raster/kernels.h"
#include "raster/blend_backward.h"
#include "raster/project_backward.h"

namespace radiant::RADIANT_ISA {

static int64_t fma_rounds(int64_t rounds, float* sink) {
  // Fused multiply-adds take 4 cycles at up to 2 a cycle: 12 chains, within 16 registers.
  constexpr int kChains = 12;
  typedef float V __attribute__((vector_size(4 * kNative)));
  V chains[kChains], factor = V{} + 0.999f, step = V{} + 1e-3f;
  for (int c = 0; c < kChains; ++c) chains[c] = V{} + static_cast<float>(c);
  for (int64_t round = 0; round < rounds; ++round)
#pragma GCC unroll 12
    for (int c = 0; c < kChains; ++c) chains[c] = chains[c] * factor + step;
  for (int c = 1; c < kChains; ++c) chains[0] += chains[c];
  *sink = chains[0][0];
  return rounds * kChains / kParts;
}

#define RADIANT_TEXT_(name) #name
#define RADIANT_TEXT(name) RADIANT_TEXT_(name)

const Kernels kernels = {RADIANT_TEXT(RADIANT_ISA), project, project_backward, blend_scratch, blend, blend_backward, fma_rounds};

}  // namespace radiant::RADIANT_ISA
