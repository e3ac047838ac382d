// Rows are dealt to threads; sums are taken per row in double and added in the image's order.
#include "training/exposure.h"

#include <vector>

#include "training/isa.h"

namespace radiant {
namespace {

constexpr std::int64_t kMinRows = 32;
constexpr int kMapSize = 12;

}  // namespace

void apply_exposure(const float* image, const float* map, float* shown, std::int64_t height, std::int64_t width, int num_threads) {
  share_rows(num_threads, height, kMinRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = 3 * begin * width; i < 3 * end * width; i += 3) {
      const float red = image[i], green = image[i + 1], blue = image[i + 2];
      for (int row = 0; row < 3; ++row) {
        const float* m = map + 4 * row;
        shown[i + row] = image[i + row] + (m[0] * red + m[1] * green + m[2] * blue + m[3]);
      }
    }
  });
}

void apply_exposure_backward(const float* image, const float* map, const float* shown_gradient, float* image_gradient, float* map_gradient,
                             std::int64_t height, std::int64_t width, int num_threads) {
  std::vector<double> row_sums(kMapSize * height);
  share_rows(num_threads, height, kMinRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t y = begin; y < end; ++y) {
      float sums[kMapSize] = {};
      double totals[kMapSize] = {};
      for (std::int64_t x = 0; x < width; ++x) {
        const std::int64_t i = 3 * (y * width + x);
        const float* g = shown_gradient + i;
        const float* c = image + i;
        for (int column = 0; column < 3; ++column) {
          image_gradient[i + column] = g[column] + (map[column] * g[0] + map[4 + column] * g[1] + map[8 + column] * g[2]);
        }
        for (int row = 0; row < 3; ++row) {
          for (int column = 0; column < 3; ++column) sums[4 * row + column] += g[row] * c[column];
          sums[4 * row + 3] += g[row];
        }
        // Short float sums into double ones: the error does not grow with the width.
        if (x % 64 == 63 || x + 1 == width) {
          for (int k = 0; k < kMapSize; ++k) {
            totals[k] += sums[k];
            sums[k] = 0;
          }
        }
      }
      for (int k = 0; k < kMapSize; ++k) row_sums[kMapSize * y + k] = totals[k];
    }
  });
  for (int k = 0; k < kMapSize; ++k) {
    double sum = 0;
    for (std::int64_t y = 0; y < height; ++y) sum += row_sums[kMapSize * y + k];
    map_gradient[k] = static_cast<float>(sum);
  }
}

}  // namespace radiant
