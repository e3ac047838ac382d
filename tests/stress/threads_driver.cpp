// Threads that share the pool, with work of any size and with exceptions, for the thread sanitizer to watch.
#include <atomic>
#include <chrono>
#include <cstdio>
#include <random>
#include <stdexcept>
#include <thread>
#include <vector>

#include "thread_pool.h"

int main() {
  std::atomic<int> failed{0};
  std::vector<std::thread> callers;
  for (unsigned seed = 0; seed < 3; ++seed)
    callers.emplace_back([seed, &failed] {
      std::mt19937 draw(seed);
      for (int round = 0; round < 3000; ++round) {
        const int threads = 1 + static_cast<int>(draw() % 6), items = static_cast<int>(draw() % 40);
        const bool throws = items > 0 && draw() % 10 == 0;
        std::vector<int> done(static_cast<std::size_t>(items));
        bool thrown = false;
        try {
          radiant::parallel_for(threads, items, [&](std::int64_t item, int worker) {
            if (worker < 0 || worker >= threads) ++failed;
            ++done[static_cast<std::size_t>(item)];
            if (throws && item == items / 2) throw std::runtime_error("expected");
          });
        } catch (const std::runtime_error&) {
          thrown = true;
        }
        if (thrown != throws) ++failed;
        for (const int times : done)
          if (times > 1 || (times == 0 && !throws)) ++failed;
        // Longer than helpers look out, now and then, so that they are met asleep too.
        if (draw() % 50 == 0) std::this_thread::sleep_for(std::chrono::microseconds(draw() % 600));
      }
    });
  for (std::thread& caller : callers) caller.join();
  std::printf("%d failed\n", failed.load());
  return failed ? 1 : 0;
}
