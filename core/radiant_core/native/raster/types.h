// What flows between the steps of the rasterizer, and the table of kernels per instruction set.
//
// Plain data only: these types cross from one instruction set's namespace into another's. Footprint
// of Gaussian i, m its centre, L upper triangular (EWA, Zwicker 2002; 3DGS, Kerbl 2023):
//     log₂ α(p) = log2_opacity − u² − v²,   (u, v) = L (p − m),   LᵀL = ½ log₂e · Σ'⁻¹
// L is formed from Σ' without xx·yy − xy², which float32 loses for long thin Gaussians.
#pragma once

#include <stdint.h>

namespace radiant {

constexpr int kTilePx = 16;          // a tile is 16 × 16 pixels
constexpr int kBlockPx = 4;          // a block is 4 × 4 pixels: one vector of 16 lanes
constexpr int kBlocksPerTile = 16;
constexpr int kPixelsPerBlock = 16;
constexpr int kMoments = 10;         // per instance, see Moments

// The constants of contract.py.
constexpr float kAlphaMin = 1.0f / 255.0f;
constexpr float kAlphaMax = 0.999f;
constexpr float kDilationPx2 = 0.3f;
constexpr float kTransmittanceCut = 1e-4f;
constexpr float kMaxHalfAxisPx = 1e9f;
constexpr float kHalfLog2e = 0.72134752f;
constexpr int kMaxSidePx = 1'000'000;  // float32 pixels and 16-bit rows of tiles hold no more

struct View {
  double rotation[9], translation[3], center[3];  // cam_from_world; the centre in the world
  double fx, fy, cx, cy;                           // px
  double near_m, far_m;
  int width, height, tiles_x, tiles_y, sh_degree;
  bool antialiased;
  float background[3];
};

// N Gaussians as they are stored; shN has num_rest bases, of which (sh_degree + 1)² − 1 are used.
struct SplatArrays {
  int64_t count;
  int num_rest;
  const float *means, *quats, *log_scales, *logit_opacities, *sh0, *shN;
};

// Gradients of the same shapes; a null pointer is not wanted. `add`: to what is there, else it is
// overwritten. `stream`: past the caches, since they could not hold it; all arrays then start at
// whole lines of 64 bytes.
struct SplatGradients {
  float *means, *quats, *log_scales, *logit_opacities, *sh0, *shN;
  bool add, stream;
};

// One cache line per Gaussian. The centre is whole pixels plus a rest: one float32 would be off by
// 3e-5 px at 500 px.
struct alignas(64) Footprint {
  float whole_x, whole_y, rest_x, rest_y;   // px
  float l11, l12, l22;                      // px⁻¹
  float log2_opacity;
  float red, green, blue, depth_m;          // a colour is exactly 0 only where it was clamped there
  float l12_over_l11, lean_y;               // least distance: x = −(l12/l11) y, y = −lean_y x
  float depth_rest_m;                       // of the float64 depth, between equal float32 ones
  float unused;
};

// A run of tiles in one row of tiles that one Gaussian reaches.
struct Span {
  uint32_t first_tile, count;
};

// A growing list of spans, grown by a function so that kernels allocate nothing themselves.
struct SpanList {
  Span* data;
  int64_t size, capacity;
  void (*reserve)(SpanList&, int64_t capacity);
};

struct Projection {
  Footprint* footprints;   // (N)
  uint32_t* depth_keys;    // (N) order of depth as unsigned integers
  uint16_t* num_spans;     // (N)
  uint32_t* num_tiles;     // (N)
  float* color_slopes;     // (⌈N/16⌉, 9, 16) ∂(red, green, blue)/∂(direction x, y, z), or null
  float* means2d;          // (N, 2)
  float* radii_px;         // (N)
};

// A Gaussian in a tile. `instance` counts all pairs of Gaussian and tile, Gaussian after Gaussian.
struct Entry {
  union {
    uint32_t depth_key;  // until the tile is sorted
    uint32_t owner;      // from then on: the Gaussian
  };
  uint32_t instance;
};

// Sums over the pixels of one instance, or of all of a Gaussian's, of h = ∂loss/∂ln α, (u, v) as
// above, and ∂loss by colour and depth.
struct Moments {
  float h, hu, hv, huu, huv, hvv, red, green, blue, depth;
};

// Sums over the same pixels of |∂loss/∂m| by x and y, times k/l₁₁ and k, k = ½ log₂e: nothing
// cancels in them (AbsGS, Ye 2024); and of w = T α.
struct AbsoluteMoments {
  float x, y, weight;
};

// What blending leaves behind for the way back, and the pictures it writes.
struct BlendState {
  const Footprint* footprints;
  uint16_t* reached;                // (instances, by tile) bit b: the entry reaches block b
  float* transmittance;             // (tiles, 16 blocks, 16 pixels) after the last entry
  int32_t* last;                    // (tiles, 16, 16) the first entry not blended, or their number
  float *images, *alphas, *depths;  // outputs (H,W,3), (H,W), (H,W)
};

// Gradients of the pictures, in their shapes, null where there is none; and the pictures.
struct ImageGradients {
  const float *images, *alphas, *depths;
  const float *out_alphas, *out_depths;
};

struct Kernels {
  const char* name;
  // Gaussians begin … end of the view; begin is a multiple of 16, so is end unless it is N.
  void (*project)(const View&, const SplatArrays&, int64_t begin, int64_t end, const Projection&, SpanList&);
  void (*project_backward)(const View&, const SplatArrays&, int64_t begin, int64_t end, const Projection&, const Moments* sums,
                           const float* means2d_gradient, const SplatGradients&);
  // Bytes of scratch that blending a tile with `count` entries needs.
  int64_t (*blend_scratch)(int64_t count);
  // Blends one tile of `count` sorted entries, `offset` and following of all tiles.
  void (*blend)(const View&, int tile, const Entry* entries, int64_t offset, int64_t count, const BlendState&, char* scratch);
  // `absolute` may be null: then nothing is summed for it.
  void (*blend_backward)(const View&, int tile, const Entry* entries, int64_t offset, int64_t count, const BlendState&, const ImageGradients&,
                         Moments* moments, AbsoluteMoments* absolute);
  // Fused multiply-adds of 16 lanes in `rounds` rounds of independent chains: the peak.
  int64_t (*fma_rounds)(int64_t rounds, float* sink);
};

}  // namespace radiant
