// Products of descriptors for one instruction set, RADIANT_ISA; matching.cmake compiles each.
//
// A lane holds the product with one of 16 others; a tile of queries shares what is read of them, so
// that no product is ever written to memory. With VNNI four bytes of a descriptor are multiplied at
// once, unsigned by signed: a . b = a . (b - 128) + 128 sum(a). Without it two 16-bit numbers are.
// Nothing here may come from a standard header's templates: the linker keeps one copy of those, and
// it might be one that the CPU cannot run.
#include "matching/kernels.h"

#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define RADIANT_TEXT_OF(name) #name
#define RADIANT_TEXT(name) RADIANT_TEXT_OF(name)
#define RADIANT_INLINE inline __attribute__((always_inline))

namespace radiant::RADIANT_ISA {

#if defined(__AVX512BW__)
constexpr int kNative = 16, kTile = 12;
#elif defined(__AVX2__)
constexpr int kNative = 8, kTile = 4;
#else
constexpr int kNative = 4, kTile = 2;
#endif
#if defined(__AVX512VNNI__)
constexpr int kPerStep = 4;
typedef uint8_t Number;
#else
constexpr int kPerStep = 2;
typedef int16_t Number;
#endif
constexpr int kParts = kGroup / kNative;
constexpr int kSteps = kDescriptorBytes / kPerStep;

typedef int32_t Part __attribute__((vector_size(4 * kNative)));

RADIANT_INLINE Part load(const void* from) {
  Part part;
  memcpy(&part, from, sizeof part);
  return part;
}

// `sum` plus, in each lane, the products of the numbers of one step.
RADIANT_INLINE Part add_products(Part sum, int32_t query, Part others) {
#if defined(__AVX512VNNI__)
  return (Part)_mm512_dpbusd_epi32((__m512i)sum, _mm512_set1_epi32(query), (__m512i)others);
#elif defined(__AVX512BW__)
  return sum + (Part)_mm512_madd_epi16(_mm512_set1_epi32(query), (__m512i)others);
#elif defined(__AVX2__)
  return sum + (Part)_mm256_madd_epi16(_mm256_set1_epi32(query), (__m256i)others);
#elif defined(__x86_64__)
  return sum + (Part)_mm_madd_epi16(_mm_set1_epi32(query), (__m128i)others);
#else
  // All numbers are 0 to 255: no sign to extend.
  return sum + (others & 0xffff) * (query & 0xffff) + (others >> 16) * (query >> 16);
#endif
}

RADIANT_INLINE Part larger(Part a, Part b) { return a > b ? a : b; }

void pack(const uint8_t* descriptors, int64_t count, int64_t num_groups, void* packed) {
  auto* out = static_cast<Number*>(packed);
  // A product with zeros is 0 in both layouts: b - 128 is stored as a signed byte.
  for (int64_t group = 0; group < num_groups; ++group)
    for (int step = 0; step < kSteps; ++step)
      for (int lane = 0; lane < kGroup; ++lane)
        for (int i = 0; i < kPerStep; ++i) {
          const int64_t row = group * kGroup + lane;
          const uint8_t value = row < count ? descriptors[row * kDescriptorBytes + step * kPerStep + i] : 0;
          *out++ = static_cast<Number>(kPerStep == 4 ? value ^ 0x80 : value);
        }
}

// One tile of queries against all groups.
template <int kQueries>
RADIANT_INLINE void compare_tile(const ProductsJob& job, int64_t begin) {
  alignas(64) Number queries[kQueries][kDescriptorBytes];
  int32_t offsets[kQueries];
  Part best[kQueries][kParts], second[kQueries][kParts], where[kQueries][kParts];
  for (int q = 0; q < kQueries; ++q) {
    const uint8_t* row = job.queries + (begin + q) * kDescriptorBytes;
    int32_t sum = 0;
    for (int i = 0; i < kDescriptorBytes; ++i) queries[q][i] = row[i], sum += row[i];
    offsets[q] = kPerStep == 4 ? 128 * sum : 0;
    for (int p = 0; p < kParts; ++p) best[q][p] = Part{} - 1, second[q][p] = Part{}, where[q][p] = Part{};
  }
  const auto* others = static_cast<const uint8_t*>(job.packed);
  for (int64_t group = 0; group < job.num_groups; ++group, others += kSteps * sizeof(Part) * kParts) {
    Part products[kQueries][kParts];
    for (int q = 0; q < kQueries; ++q)
      for (int p = 0; p < kParts; ++p) products[q][p] = Part{} + offsets[q];
    for (int step = 0; step < kSteps; ++step)
      for (int q = 0; q < kQueries; ++q) {
        int32_t query;
        memcpy(&query, &queries[q][step * kPerStep], 4);
        for (int p = 0; p < kParts; ++p) products[q][p] = add_products(products[q][p], query, load(others + (step * kParts + p) * sizeof(Part)));
      }
    for (int p = 0; p < kParts; ++p) {
      int32_t* column = job.column_best + group * kGroup + p * kNative;
      Part most = load(column);
      const Part number = Part{} + static_cast<int32_t>(group);
      for (int q = 0; q < kQueries; ++q) {
        const Part product = products[q][p];
        most = larger(most, product);
        const auto greater = product > best[q][p];
        second[q][p] = greater ? best[q][p] : larger(second[q][p], product);
        where[q][p] = greater ? number : where[q][p];
        best[q][p] = greater ? product : best[q][p];
      }
      memcpy(column, &most, sizeof most);
    }
  }
  for (int q = 0; q < kQueries; ++q) {
    int32_t first = -1, next = 0, index = 0;
    for (int p = 0; p < kParts; ++p)
      for (int lane = 0; lane < kNative; ++lane) {
        const int32_t product = best[q][p][lane], at = where[q][p][lane] * kGroup + p * kNative + lane;
        const bool wins = product > first || (product == first && at < index);
        const int32_t loser = wins ? first : product;
        next = loser > next ? loser : next;
        next = second[q][p][lane] > next ? second[q][p][lane] : next;
        if (wins) first = product, index = at;
      }
    job.best[begin + q] = first, job.second[begin + q] = next, job.best_index[begin + q] = index;
  }
}

void compare(const ProductsJob& job) {
  int64_t begin = 0;
  for (; begin + kTile <= job.num_queries; begin += kTile) compare_tile<kTile>(job, begin);
  for (; begin < job.num_queries; ++begin) compare_tile<1>(job, begin);
}

extern const MatchingKernels matching_kernels;
const MatchingKernels matching_kernels = {RADIANT_TEXT(RADIANT_ISA), static_cast<int64_t>(kGroup * kDescriptorBytes * sizeof(Number)), pack, compare};

}  // namespace radiant::RADIANT_ISA
