// Threads that stay: a rendering has six parallel steps of a few ms; starting a thread takes 30 µs.
#pragma once

#include <cstdint>
#include <functional>

namespace radiant {

// Calls work(item, worker) for every item in 0 … items−1 on up to `threads` threads, the caller
// among them; worker < threads. Results must not depend on the worker. Rethrows the first
// exception.
void parallel_for(int threads, std::int64_t items, const std::function<void(std::int64_t item, int worker)>& work);

}  // namespace radiant
