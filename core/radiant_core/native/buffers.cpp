#include "buffers.h"

#include <cstdlib>
#include <mutex>
#include <new>
#include <vector>
#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace radiant {
namespace {

constexpr std::size_t kHugePage = std::size_t{2} << 20;
constexpr std::size_t kMaxFreeBlocks = 24;  // two sets of six gradients and six outputs

struct Block {
  void* memory;
  std::size_t bytes;
};

struct Pool {
  std::mutex mutex;
  std::vector<Block> free, taken;
};

// Never destroyed: arrays may come back while the interpreter shuts down.
Pool& pool() {
  static Pool& instance = *new Pool;
  return instance;
}

}  // namespace

void* allocate_pages(std::size_t bytes) {
  const bool large = bytes >= 2 * kHugePage;
  const std::size_t alignment = large ? kHugePage : 64;
  void* memory = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
  if (!memory) throw std::bad_alloc();
#if defined(__linux__) && defined(MADV_HUGEPAGE)
  // Only a wish; 4 KiB pages work as well, slower.
  if (large) madvise(memory, (bytes + alignment - 1) / alignment * alignment, MADV_HUGEPAGE);
#endif
  return memory;
}

void free_pages(void* memory) noexcept { std::free(memory); }

void* pool_take(std::size_t bytes) {
  Pool& p = pool();
  const std::lock_guard lock(p.mutex);
  std::size_t best = p.free.size();
  for (std::size_t i = 0; i < p.free.size(); ++i) {
    const std::size_t size = p.free[i].bytes;
    if (size >= bytes && size <= 2 * bytes + 4096 && (best == p.free.size() || size < p.free[best].bytes)) best = i;
  }
  p.taken.reserve(p.taken.size() + 1);
  p.free.reserve(p.free.size() + p.taken.size() + 1);
  if (best < p.free.size()) {
    const Block block = p.free[best];
    p.free.erase(p.free.begin() + static_cast<std::ptrdiff_t>(best));
    p.taken.push_back(block);
    return block.memory;
  }
  const Block block{allocate_pages(bytes ? bytes : 1), bytes};
  p.taken.push_back(block);
  return block.memory;
}

void pool_return(void* memory) noexcept {
  Pool& p = pool();
  const std::lock_guard lock(p.mutex);
  for (std::size_t i = 0; i < p.taken.size(); ++i) {
    if (p.taken[i].memory != memory) continue;
    p.free.push_back(p.taken[i]);  // reserved by pool_take
    p.taken.erase(p.taken.begin() + static_cast<std::ptrdiff_t>(i));
    break;
  }
  if (p.free.size() > kMaxFreeBlocks) {
    free_pages(p.free.front().memory);
    p.free.erase(p.free.begin());
  }
}

}  // namespace radiant
