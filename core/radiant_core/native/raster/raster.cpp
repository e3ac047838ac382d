#include "raster/raster.h"

#include <algorithm>
#include <cstring>
#include <stdexcept>

#include "machine/instruction_sets.h"
#include "machine/thread_pool.h"
#include "raster/depth_sort.h"
#include "raster/kernels.h"

namespace radiant {
namespace {

// The list and its storage travel together through the kernel, which knows only the list.
struct GrowingSpans : SpanList {
  Buffer<Span>* storage;
};

void grow_spans(SpanList& spans, std::int64_t capacity) {
  auto& growing = static_cast<GrowingSpans&>(spans);
  Buffer<Span> larger;
  larger.reserve(static_cast<std::size_t>(std::max(capacity, 2 * spans.capacity)));
  if (spans.size) std::memcpy(larger.data(), spans.data, static_cast<std::size_t>(spans.size) * sizeof(Span));
  growing.storage->swap(larger);
  spans.data = growing.storage->data();
  spans.capacity = static_cast<std::int64_t>(growing.storage->capacity());
}

// Gradients that no cache would keep until somebody reads them are written past the caches: 1.3
// times as fast for 500,000 Gaussians.
bool can_stream(const SplatArrays& splats, const SplatGradients& to) {
  constexpr std::int64_t kCacheBytes = std::int64_t{16} << 20;
  bool aligned = true;
  for (const float* array : {to.means, to.quats, to.log_scales, to.logit_opacities, to.sh0, to.shN})
    aligned = aligned && reinterpret_cast<std::uintptr_t>(array) % 64 == 0;
  return aligned && !to.add && splats.count * (14 + 3 * splats.num_rest) * static_cast<std::int64_t>(sizeof(float)) > kCacheBytes;
}

}  // namespace

std::int64_t RenderedView::chunk_end(std::size_t chunk) const { return std::min(count_, chunk_begin(chunk) + chunk_size_); }

void RenderedView::forward(const Kernels& kernels, const View& view, const SplatArrays& splats, const ViewOutputs& out, bool differentiable,
                           int threads) {
  kernels_ = &kernels;
  view_ = view;
  count_ = splats.count;
  differentiable_ = differentiable;
  release_unused();
  const std::int64_t tiles = static_cast<std::int64_t>(view.tiles_x) * view.tiles_y;
  project(splats, out, threads);
  fill_tiles(threads);
  const auto pixels = static_cast<std::size_t>(tiles * kTilePx * kTilePx);
  blend_ = {footprints_.data(),
            reached_.reserve(static_cast<std::size_t>(num_instances_)),
            transmittance_.reserve(pixels),
            last_.reserve(pixels),
            out.images,
            out.alphas,
            out.depths};
  if (workers_.size() < static_cast<std::size_t>(threads)) workers_.resize(static_cast<std::size_t>(threads));
  parallel_for(threads, tiles, [&](std::int64_t tile, int worker) { blend_tile(tile, workers_[static_cast<std::size_t>(worker)]); });
}

template <class Visit>
void RenderedView::for_each_buffer(const Visit& visit) {
  visit(footprints_), visit(depth_keys_), visit(num_tiles_), visit(owners_), visit(cursors_), visit(num_spans_), visit(reached_);
  visit(color_slopes_), visit(transmittance_), visit(last_), visit(entries_), visit(tile_starts_);
}

void RenderedView::release_unused() {
  constexpr int kPatience = 16;
  std::size_t used = 0, held = 0;
  for_each_buffer([&](const auto& buffer) { used += buffer.reserved_bytes(), held += buffer.capacity_bytes(); });
  num_small_ = 4 * used < held ? num_small_ + 1 : 0;
  if (num_small_ < kPatience) return;
  for_each_buffer([](auto& buffer) { buffer.release(); });
  chunks_.clear();
  workers_.clear();
  num_small_ = 0;
}

Projection RenderedView::projection(const ViewOutputs& out) const {
  return {footprints_.data(),   depth_keys_.data(), num_spans_.data(), num_tiles_.data(),
          differentiable_ ? color_slopes_.data() : nullptr, out.means2d, out.radii_px};
}

void RenderedView::project(const SplatArrays& splats, const ViewOutputs& out, int threads) {
  const auto count = static_cast<std::size_t>(count_);
  footprints_.reserve(count);
  depth_keys_.reserve(count);
  num_spans_.reserve(count);
  num_tiles_.reserve(count);
  color_slopes_.reserve(differentiable_ ? (count + 15) / 16 * 16 * 9 : 0);
  // At most 64 chunks, so that their tile counts stay small, of whole vectors.
  chunk_size_ = std::clamp<std::int64_t>((count_ + 63) / 64, 1024, 16384);
  chunk_size_ = (chunk_size_ + 15) / 16 * 16;
  num_chunks_ = static_cast<std::size_t>((count_ + chunk_size_ - 1) / chunk_size_);
  if (chunks_.size() < num_chunks_) chunks_.resize(num_chunks_);
  const Projection projected = projection(out);
  parallel_for(threads, static_cast<std::int64_t>(num_chunks_), [&](std::int64_t index, int) {
    const auto c = static_cast<std::size_t>(index);
    Chunk& chunk = chunks_[c];
    GrowingSpans spans;
    static_cast<SpanList&>(spans) = {chunk.storage.data(), 0, static_cast<std::int64_t>(chunk.storage.capacity()), grow_spans};
    spans.storage = &chunk.storage;
    kernels_->project(view_, splats, chunk_begin(c), chunk_end(c), projected, spans);
    chunk.spans = spans;
  });
}

void RenderedView::fill_tiles(int threads) {
  const auto tiles = static_cast<std::size_t>(view_.tiles_x) * static_cast<std::size_t>(view_.tiles_y);
  const auto chunks = static_cast<std::int64_t>(num_chunks_);
  std::uint32_t* cursors = cursors_.reserve(num_chunks_ * tiles);
  parallel_for(threads, chunks, [&](std::int64_t c, int) {
    std::uint32_t* counts = cursors + static_cast<std::size_t>(c) * tiles;
    std::memset(counts, 0, tiles * sizeof(std::uint32_t));
    const SpanList& spans = chunks_[static_cast<std::size_t>(c)].spans;
    for (std::int64_t s = 0; s < spans.size; ++s)
      for (std::uint32_t i = 0; i < spans.data[s].count; ++i) ++counts[spans.data[s].first_tile + i];
  });
  // Tile after tile, within a tile chunk after chunk: the counting sort is stable.
  std::int64_t* starts = tile_starts_.reserve(tiles + 1);
  std::int64_t next = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    starts[tile] = next;
    for (std::size_t c = 0; c < num_chunks_; ++c) {
      std::uint32_t& count = cursors[c * tiles + tile];
      const std::uint32_t size = count;
      count = static_cast<std::uint32_t>(next);
      next += size;
    }
  }
  starts[tiles] = num_instances_ = next;
  if (next > static_cast<std::int64_t>(UINT32_MAX)) throw std::length_error("more than 2^32 pairs of Gaussian and tile");
  std::int64_t first_instance = 0;
  for (std::size_t c = 0; c < num_chunks_; ++c) {
    chunks_[c].first_instance = first_instance;
    for (std::int64_t s = 0; s < chunks_[c].spans.size; ++s) first_instance += chunks_[c].spans.data[s].count;
  }
  Entry* entries = entries_.reserve(static_cast<std::size_t>(next));
  std::uint32_t* owners = owners_.reserve(static_cast<std::size_t>(next));
  parallel_for(threads, chunks, [&](std::int64_t index, int) {
    const auto c = static_cast<std::size_t>(index);
    std::uint32_t* cursor = cursors + c * tiles;
    const Span* span = chunks_[c].spans.data;
    auto instance = static_cast<std::uint32_t>(chunks_[c].first_instance);
    for (std::int64_t g = chunk_begin(c); g < chunk_end(c); ++g)
      for (const Span* end = span + num_spans_.data()[g]; span != end; ++span)
        for (std::uint32_t i = 0; i < span->count; ++i, ++instance) {
          entries[cursor[span->first_tile + i]++] = {depth_keys_.data()[g], instance};
          owners[instance] = static_cast<std::uint32_t>(g);
        }
  });
}

void RenderedView::order_equal_depths(Entry* entries, std::size_t count) const {
  const auto rest = [this](const Entry& entry) { return footprints_.data()[owners_.data()[entry.instance]].depth_rest_m; };
  for (std::size_t i = 1; i < count; ++i) {
    if (entries[i].depth_key != entries[i - 1].depth_key) continue;
    std::size_t end = i + 1;
    while (end < count && entries[end].depth_key == entries[i].depth_key) ++end;
    std::stable_sort(entries + i - 1, entries + end, [&](const Entry& a, const Entry& b) { return rest(a) < rest(b); });
    i = end;
  }
}

void RenderedView::blend_tile(std::int64_t tile, Worker& worker) {
  const std::int64_t start = tile_starts_.data()[tile], count = tile_starts_.data()[tile + 1] - start;
  Entry* entries = entries_.data() + start;
  sort_by_depth(entries, worker.spare.reserve(static_cast<std::size_t>(count)), static_cast<std::size_t>(count));
  order_equal_depths(entries, static_cast<std::size_t>(count));
  for (std::int64_t i = 0; i < count; ++i) entries[i].owner = owners_.data()[entries[i].instance];
  char* scratch = worker.scratch.reserve(static_cast<std::size_t>(kernels_->blend_scratch(count)));
  kernels_->blend(view_, static_cast<int>(tile), entries, start, count, blend_, scratch);
}

void RenderedView::blend_backward(const ImageGradients& gradients, float* means2d, Moments* sums, float* absgrad, float* weights,
                                  int threads) const {
  const auto instances = static_cast<std::size_t>(num_instances_);
  const PooledBlock memory(instances * (sizeof(Moments) + (absgrad ? sizeof(AbsoluteMoments) : 0)));
  auto* const moments = static_cast<Moments*>(memory.data());
  auto* const absolute = absgrad ? reinterpret_cast<AbsoluteMoments*>(moments + instances) : nullptr;
  parallel_for(threads, static_cast<std::int64_t>(view_.tiles_x) * view_.tiles_y, [&](std::int64_t tile, int) {
    const std::int64_t start = tile_starts_.data()[tile], count = tile_starts_.data()[tile + 1] - start;
    if (count > 0)
      kernels_->blend_backward(view_, static_cast<int>(tile), entries_.data() + start, start, count, blend_, gradients, moments, absolute);
  });
  parallel_for(threads, static_cast<std::int64_t>(num_chunks_), [&](std::int64_t chunk, int) {
    sum_chunk(static_cast<std::size_t>(chunk), moments, means2d, sums);
    if (absolute) sum_absolute(static_cast<std::size_t>(chunk), absolute, absgrad, weights);
  });
}

// Sums the instances of each Gaussian, whose moments stand one after another, and moves to its
// centre: ∂ln α/∂m = 1/k Lᵀ (u, v).
void RenderedView::sum_chunk(std::size_t chunk, const Moments* moments, float* means2d, Moments* sums) const {
  const Moments* instance = moments + chunks_[chunk].first_instance;
  for (std::int64_t g = chunk_begin(chunk); g < chunk_end(chunk); ++g) {
    Moments sum{};
    const Moments* const end = instance + num_tiles_.data()[g];
    float x = 0, y = 0;
    if (instance != end) {
      sum = *instance++;
      for (; instance != end; ++instance)
        for (int k = 0; k < kMoments; ++k) reinterpret_cast<float*>(&sum)[k] += reinterpret_cast<const float*>(instance)[k];
      const Footprint& at = footprints_.data()[g];
      x = at.l11 * sum.hu / kHalfLog2e;
      y = (at.l12 * sum.hu + at.l22 * sum.hv) / kHalfLog2e;
      // A colour that was clamped at 0 has no gradient.
      sum.red = at.red > 0 ? sum.red : 0;
      sum.green = at.green > 0 ? sum.green : 0;
      sum.blue = at.blue > 0 ? sum.blue : 0;
    }
    sums[g] = sum;
    means2d[2 * g] = x;
    means2d[2 * g + 1] = y;
  }
}

void RenderedView::sum_absolute(std::size_t chunk, const AbsoluteMoments* moments, float* absgrad, float* weights) const {
  const AbsoluteMoments* instance = moments + chunks_[chunk].first_instance;
  for (std::int64_t g = chunk_begin(chunk); g < chunk_end(chunk); ++g) {
    AbsoluteMoments sum{};
    for (std::uint32_t i = 0; i < num_tiles_.data()[g]; ++i, ++instance) {
      sum.x += instance->x, sum.y += instance->y;
      sum.weight += instance->weight;
    }
    // A Gaussian that is not drawn has no footprint to read.
    absgrad[2 * g] = num_tiles_.data()[g] ? footprints_.data()[g].l11 * sum.x / kHalfLog2e : 0;
    absgrad[2 * g + 1] = sum.y / kHalfLog2e;
    weights[g] = sum.weight;
  }
}

void RenderedView::project_backward(const SplatArrays& splats, const float* means2d, const Moments* sums, const SplatGradients& gradients,
                                    int threads) const {
  const Projection projected = projection({});
  SplatGradients to = gradients;
  to.stream = can_stream(splats, gradients);
  parallel_for(threads, static_cast<std::int64_t>(num_chunks_), [&](std::int64_t index, int) {
    const auto c = static_cast<std::size_t>(index);
    kernels_->project_backward(view_, splats, chunk_begin(c), chunk_end(c), projected, sums, means2d, to);
  });
}

std::int64_t RenderedView::num_block_pairs() const {
  std::int64_t pairs = 0;
  for (std::int64_t i = 0; i < num_instances_; ++i) pairs += __builtin_popcount(reached_.data()[i]);
  return pairs;
}

const Kernels* find_kernels(const std::string& name) {
#if defined(RADIANT_X86)
  return find_build({&avx512::kernels, &avx2::kernels, &portable::kernels}, name);
#else
  return find_build({&portable::kernels}, name);
#endif
}

}  // namespace radiant
