#include "machine/thread_pool.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>
#if defined(__unix__) || defined(__APPLE__)
#include <unistd.h>
#endif

namespace radiant {
namespace {

struct Job {
  const std::function<void(std::int64_t, int)>* work;
  std::int64_t items;
  std::atomic<std::int64_t> next{0};
  std::exception_ptr error;
  std::mutex error_mutex;

  void run(int worker) noexcept {
    try {
      for (std::int64_t item; (item = next.fetch_add(1)) < items;) (*work)(item, worker);
    } catch (...) {
      next = items;
      const std::lock_guard lock(error_mutex);
      if (!error) error = std::current_exception();
    }
  }
};

void pause_briefly() {
#if defined(RADIANT_X86)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#else
  std::this_thread::yield();
#endif
}

// Polls `ready` before the caller sleeps: waking a sleeping thread takes as long as a short step.
template <class Ready>
void look_out(const Ready& ready) {
  constexpr auto kPatience = std::chrono::microseconds(200);
  const auto start = std::chrono::steady_clock::now();
  while (!ready() && std::chrono::steady_clock::now() - start < kPatience)
    for (int i = 0; i < 16 && !ready(); ++i) pause_briefly();
}

// One value that one thread sets and another waits for.
template <class Value>
class Mailbox {
 public:
  void put(Value value) {
    {
      const std::lock_guard lock(mutex_);
      value_ = value;
    }
    arrived_.notify_one();
  }
  Value take() {
    const auto ready = [this] { return value_ != Value{}; };
    look_out(ready);
    std::unique_lock lock(mutex_);
    arrived_.wait(lock, ready);
    return value_.exchange(Value{});
  }

 private:
  std::mutex mutex_;
  std::condition_variable arrived_;
  std::atomic<Value> value_{};
};

int process_id() {
#if defined(__unix__) || defined(__APPLE__)
  return static_cast<int>(getpid());
#else
  return 0;
#endif
}

class Pool {
 public:
  const int owner = process_id();

  // False when another thread uses the pool just now, or no thread can be started.
  bool run(int helpers, Job& job) {
    if (busy_.exchange(true)) return false;
    helpers = start(std::min(helpers, max_helpers_));
    if (helpers > 0) {
      running_ = helpers;
      for (int i = 0; i < helpers; ++i) jobs_[static_cast<std::size_t>(i)]->put(&job);
      job.run(0);
      finished_.take();
    }
    busy_ = false;
    return helpers > 0;
  }

 private:
  // How many of `wanted` helpers there are now.
  int start(int wanted) {
    while (static_cast<int>(jobs_.size()) < wanted) {
      jobs_.push_back(std::make_unique<Mailbox<Job*>>());
      try {
        std::thread(&Pool::serve, this, jobs_.back().get(), static_cast<int>(jobs_.size())).detach();
      } catch (const std::system_error&) {
        jobs_.pop_back();  // the system has no more threads: those that run will do
        break;
      }
    }
    return std::min(wanted, static_cast<int>(jobs_.size()));
  }

  void serve(Mailbox<Job*>* jobs, int worker) {
    for (;;) {
      jobs->take()->run(worker);
      if (--running_ == 0) finished_.put(true);
    }
  }

  // More would take turns; results do not depend on their number.
  const int max_helpers_ = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  std::atomic<bool> busy_{false};
  std::atomic<int> running_{0};
  std::vector<std::unique_ptr<Mailbox<Job*>>> jobs_;  // one per helper: the others sleep on
  Mailbox<bool> finished_;
};

// Never destroyed, since its threads end with the process; a forked child has none of them and gets
// a pool of its own, without a lock, which it could inherit locked.
Pool& pool() {
  static std::atomic<Pool*> current{nullptr};
  Pool* found = current;
  if (found && found->owner == process_id()) return *found;
  auto fresh = std::make_unique<Pool>();
  return current.compare_exchange_strong(found, fresh.get()) ? *fresh.release() : *found;
}

}  // namespace

void parallel_for(int threads, std::int64_t items, const std::function<void(std::int64_t, int)>& work) {
  Job job;
  job.work = &work;
  job.items = items;
  const int helpers = static_cast<int>(items < threads ? items : threads) - 1;
  if (helpers < 1 || !pool().run(helpers, job)) job.run(0);
  if (job.error) std::rethrow_exception(job.error);
}

}  // namespace radiant
