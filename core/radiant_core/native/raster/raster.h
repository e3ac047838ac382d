// One rendered view: what the forward pass leaves for the backward pass, the order of the steps.
//
// Forward, O(N + instances + pixels · depth complexity): project (chunks of Gaussians) → count and
// fill tile lists (stable) → per tile: sort by depth, list the blocks each Gaussian reaches, blend.
// Backward: per tile, a sum per Gaussian, the projection. Every sum has a fixed order: results have
// the same bits for any number of threads.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "raster/buffers.h"
#include "raster/types.h"

namespace radiant {

struct ViewOutputs {
  float *images, *alphas, *depths, *means2d, *radii_px;
};

class RenderedView {
 public:
  RenderedView() = default;
  RenderedView(const RenderedView&) = delete;
  RenderedView& operator=(const RenderedView&) = delete;

  // Renders into `out`; keeps what `backward` needs if `differentiable`. Memory that renderings in
  // a row use less than a quarter of is freed. Throws std::length_error beyond 2³² instances.
  void forward(const Kernels& kernels, const View& view, const SplatArrays& splats, const ViewOutputs& out, bool differentiable, int threads);

  // ∂loss/∂means2d (N,2) and, for all else, the sums over each Gaussian's pixels (N); `absgrad`
  // (N,2) or null: sums of each pixel's |∂loss/∂means2d|; with it `weights` (N): sums of w = T α.
  // Passes of several threads may overlap.
  void blend_backward(const ImageGradients& gradients, float* means2d, Moments* sums, float* absgrad, float* weights, int threads) const;

  // Gradients of the Gaussians, from what `blend_backward` gave.
  void project_backward(const SplatArrays& splats, const float* means2d, const Moments* sums, const SplatGradients& gradients,
                        int threads) const;

  // Pairs of Gaussian and tile, and of Gaussian and block, of the last forward pass.
  std::int64_t num_instances() const { return num_instances_; }
  std::int64_t num_block_pairs() const;

 private:
  // Gaussians projected and counted as one, the same for any number of threads.
  struct Chunk {
    Buffer<Span> storage;
    SpanList spans{};
    std::int64_t first_instance = 0;
  };
  // What one thread needs.
  struct Worker {
    Buffer<char> scratch;
    Buffer<Entry> spare;
  };

  void release_unused();
  template <class Visit>
  void for_each_buffer(const Visit& visit);
  void project(const SplatArrays& splats, const ViewOutputs& out, int threads);
  void fill_tiles(int threads);
  void blend_tile(std::int64_t tile, Worker& worker);
  void order_equal_depths(Entry* entries, std::size_t count) const;
  void sum_chunk(std::size_t chunk, const Moments* moments, float* means2d, Moments* sums) const;
  void sum_absolute(std::size_t chunk, const AbsoluteMoments* moments, float* absgrad, float* weights) const;
  Projection projection(const ViewOutputs& out) const;
  std::int64_t chunk_begin(std::size_t chunk) const { return static_cast<std::int64_t>(chunk) * chunk_size_; }
  std::int64_t chunk_end(std::size_t chunk) const;

  const Kernels* kernels_ = nullptr;
  View view_{};
  std::int64_t count_ = 0, chunk_size_ = 0, num_instances_ = 0;
  std::size_t num_chunks_ = 0;
  bool differentiable_ = false;
  int num_small_ = 0;  // renderings in a row that used little of the memory
  std::vector<Chunk> chunks_;
  std::vector<Worker> workers_;
  Buffer<Footprint> footprints_;
  Buffer<std::uint32_t> depth_keys_, num_tiles_, owners_, cursors_;
  Buffer<std::uint16_t> num_spans_, reached_;
  Buffer<float> color_slopes_, transmittance_;
  Buffer<std::int32_t> last_;
  Buffer<Entry> entries_;
  Buffer<std::int64_t> tile_starts_;
  BlendState blend_{};
};

// The kernels of `name`, or the fastest for an empty one; null if this CPU or build has none of it.
const Kernels* find_kernels(const std::string& name);

}  // namespace radiant
