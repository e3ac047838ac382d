#include "raster/buffers.h"

#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <new>
#include <vector>
#if defined(__linux__)
#include <sys/mman.h>
#endif
#if defined(_WIN32)
#include <malloc.h>
#endif
#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace radiant {
namespace {

constexpr std::size_t kHugePage = std::size_t{2} << 20;
// A training step takes some 14 blocks: what was not needed lately goes back to the system.
constexpr std::uint64_t kTakesToKeep = 64;

struct Block {
  void* memory;
  std::size_t bytes;
  std::uint64_t returned_at;  // in takes
};

struct Pool {
  std::mutex mutex;
  std::vector<Block> free, taken;
  std::uint64_t takes = 0;
};

Pool& make_pool();

// Never destroyed: arrays may come back while the interpreter shuts down.
Pool& pool = make_pool();

Pool& make_pool() {
#if defined(__unix__) || defined(__APPLE__)
  // A child of a process whose other thread is in here would inherit the mutex locked.
  pthread_atfork([] { pool.mutex.lock(); }, [] { pool.mutex.unlock(); }, [] { pool.mutex.unlock(); });
#endif
  return *new Pool;
}

}  // namespace

void* allocate_pages(std::size_t bytes) {
  const bool large = bytes >= 2 * kHugePage;
  const std::size_t alignment = large ? kHugePage : 64;
#if defined(_WIN32)
  void* memory = _aligned_malloc(bytes, alignment);
#else
  void* memory = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
#endif
  if (!memory) throw std::bad_alloc();
#if defined(__linux__) && defined(MADV_HUGEPAGE)
  // Only a wish; 4 KiB pages work as well, slower.
  if (large) madvise(memory, (bytes + alignment - 1) / alignment * alignment, MADV_HUGEPAGE);
#endif
  return memory;
}

void free_pages(void* memory) noexcept {
#if defined(_WIN32)
  _aligned_free(memory);
#else
  std::free(memory);
#endif
}

void* pool_take(std::size_t bytes) {
  const std::lock_guard lock(pool.mutex);
  std::size_t best = pool.free.size();
  for (std::size_t i = 0; i < pool.free.size(); ++i) {
    const std::size_t size = pool.free[i].bytes;
    if (size >= bytes && size <= 2 * bytes + 4096 && (best == pool.free.size() || size < pool.free[best].bytes)) best = i;
  }
  pool.taken.reserve(pool.taken.size() + 1);
  pool.free.reserve(pool.free.size() + pool.taken.size() + 1);
  ++pool.takes;
  if (best < pool.free.size()) {
    pool.taken.push_back(pool.free[best]);
    pool.free.erase(pool.free.begin() + static_cast<std::ptrdiff_t>(best));
  } else {
    pool.taken.push_back({allocate_pages(bytes ? bytes : 1), bytes, 0});
  }
  void* const memory = pool.taken.back().memory;
  // Returned one after another, so the longest unused stand first.
  while (!pool.free.empty() && pool.takes - pool.free.front().returned_at > kTakesToKeep) {
    free_pages(pool.free.front().memory);
    pool.free.erase(pool.free.begin());
  }
  return memory;
}

void pool_return(void* memory) noexcept {
  const std::lock_guard lock(pool.mutex);
  const auto block = std::find_if(pool.taken.begin(), pool.taken.end(), [&](const Block& taken) { return taken.memory == memory; });
  block->returned_at = pool.takes;
  pool.free.push_back(*block);  // reserved by pool_take
  pool.taken.erase(block);
}

}  // namespace radiant
