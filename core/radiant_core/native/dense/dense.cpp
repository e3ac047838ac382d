// Pads the lattice so that kernels may read 16 nodes beyond a row, and deals rows to threads.
#include "dense/dense.h"

#include <algorithm>
#include <utility>

#include "machine/instruction_sets.h"
#include "machine/thread_pool.h"

namespace radiant {

namespace portable { extern const DenseKernels dense_kernels; }
#ifdef RADIANT_X86
namespace avx2 { extern const DenseKernels dense_kernels; }
namespace avx512 { extern const DenseKernels dense_kernels; }
#endif

namespace {

constexpr std::int64_t kPad = 16;

// Rows of a lattice with 16 floats on either side.
class Lattice {
 public:
  Lattice(std::int64_t planes, std::int64_t rows, std::int64_t columns, float value)
      : rows_(rows), columns_(columns), stride_((columns + kPad - 1) / kPad * kPad + 2 * kPad), values_(planes * rows * stride_, value) {}

  std::int64_t stride() const { return stride_; }
  float* plane(std::int64_t index) { return values_.data() + index * rows_ * stride_ + kPad; }
  PlaneRows planes() { return {plane(0), plane(1), plane(2), plane(3)}; }

  void fill(std::int64_t index, const float* from) {
    for (std::int64_t row = 0; row < rows_; ++row) std::copy_n(from + row * columns_, columns_, plane(index) + row * stride_);
  }
  void copy_out(std::int64_t index, float* to) {
    for (std::int64_t row = 0; row < rows_; ++row) std::copy_n(plane(index) + row * stride_, columns_, to + row * columns_);
  }

 private:
  std::int64_t rows_, columns_, stride_;
  std::vector<float> values_;
};

}  // namespace

const DenseKernels* find_dense_kernels(const std::string& name) {
#ifdef RADIANT_X86
  return find_build({&avx512::dense_kernels, &avx2::dense_kernels, &portable::dense_kernels}, name);
#else
  return find_build({&portable::dense_kernels}, name);
#endif
}

std::vector<std::uint32_t> grey_quads(const std::uint8_t* grey, int width, int height) {
  std::vector<std::uint32_t> quads(static_cast<std::size_t>(width) * height);
  for (int y = 0; y < height; ++y) {
    const std::uint8_t* upper = grey + static_cast<std::size_t>(y) * width;
    const std::uint8_t* lower = y + 1 < height ? upper + width : upper;
    std::uint32_t* out = quads.data() + static_cast<std::size_t>(y) * width;
    for (int x = 0; x < width; ++x) {
      const int next = x + 1 < width ? x + 1 : x;
      out[x] = upper[x] | upper[next] << 8 | lower[x] << 16 | static_cast<std::uint32_t>(lower[next]) << 24;
    }
  }
  return quads;
}

void match_planes(DepthJob job, const float* candidates, std::int64_t num_candidates, const std::vector<DepthPass>& passes, float* planes,
                  float* costs, const DenseKernels& kernels, int num_threads) {
  const std::int64_t nodes = job.rows * job.columns;
  Lattice now(4, job.rows, job.columns, 0.0f), next(4, job.rows, job.columns, 0.0f), candidate(3, job.rows, job.columns, 0.0f);
  job.stride = now.stride();
  // Dearer than any plane, so that the first candidate is taken even where nothing can be compared.
  std::fill_n(now.plane(3) - kPad, job.rows * job.stride, 3.0f);
  job.to = now.planes();
  for (std::int64_t index = 0; index < num_candidates; ++index) {
    for (int part = 0; part < 3; ++part) candidate.fill(part, candidates + (3 * index + part) * nodes);
    parallel_for(num_threads, job.rows, [&](std::int64_t row, int) { kernels.try_rows(job, candidate.plane(0), row, row + 1); });
  }
  for (const DepthPass& pass : passes) {
    job.from = now.planes();
    job.to = next.planes();
    parallel_for(num_threads, job.rows, [&](std::int64_t row, int) { kernels.pass_rows(job, pass, row, row + 1); });
    std::swap(now, next);
  }
  for (int part = 0; part < 3; ++part) now.copy_out(part, planes + part * nodes);
  now.copy_out(3, costs);
}

}  // namespace radiant
