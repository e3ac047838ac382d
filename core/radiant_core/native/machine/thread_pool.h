// Threads that stay: a rendering has some six parallel steps of a few milliseconds, and starting a
// thread takes 30 µs.
#pragma once

#include <cstdint>
#include <functional>

namespace radiant {

// Calls work(item, worker) for every item in 0 … items−1 on up to `threads` threads, the caller
// among them; worker < threads. Which worker gets an item is left to chance, so results must not
// depend on it. Rethrows the first exception.
void parallel_for(int threads, std::int64_t items, const std::function<void(std::int64_t item, int worker)>& work);

}  // namespace radiant
