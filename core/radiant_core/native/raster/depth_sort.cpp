// Least-significant-digit radix sort over only the bits in which a tile's depths differ.
#include "raster/depth_sort.h"

#include <cstring>
#include <utility>

namespace radiant {
namespace {

constexpr std::size_t kShort = 24;
constexpr int kDigitBits = 8;

void insertion_sort(Entry* entries, std::size_t count) {
  for (std::size_t i = 1; i < count; ++i) {
    const Entry entry = entries[i];
    std::size_t j = i;
    for (; j > 0 && entries[j - 1].depth_key > entry.depth_key; --j) entries[j] = entries[j - 1];
    entries[j] = entry;
  }
}

}  // namespace

void sort_by_depth(Entry* entries, Entry* spare, std::size_t count) {
  if (count <= kShort) return insertion_sort(entries, count);
  std::uint32_t low = entries[0].depth_key, high = low;
  for (std::size_t i = 1; i < count; ++i) {
    const std::uint32_t key = entries[i].depth_key;
    low = key < low ? key : low;
    high = key > high ? key : high;
  }
  Entry *from = entries, *to = spare;
  for (int shift = 0; shift < 32 && ((high - low) >> shift) != 0; shift += kDigitBits) {
    std::uint32_t place[1 << kDigitBits] = {};
    for (std::size_t i = 0; i < count; ++i) ++place[((from[i].depth_key - low) >> shift) & 0xff];
    std::uint32_t next = 0;
    for (std::uint32_t& p : place) next += std::exchange(p, next);
    for (std::size_t i = 0; i < count; ++i) to[place[((from[i].depth_key - low) >> shift) & 0xff]++] = from[i];
    std::swap(from, to);
  }
  if (from != entries) std::memcpy(entries, from, count * sizeof(Entry));
}

}  // namespace radiant
