#include "thread_pool.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
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

// Looks for `ready` for a while before the caller sleeps: waking a sleeping thread takes as long as a short step.
template <class Ready>
void look_out(const Ready& ready) {
  constexpr auto kPatience = std::chrono::microseconds(200);
  const auto start = std::chrono::steady_clock::now();
  while (!ready() && std::chrono::steady_clock::now() - start < kPatience)
    for (int i = 0; i < 16 && !ready(); ++i) {
#if defined(RADIANT_X86)
      __builtin_ia32_pause();
#endif
    }
}

class Pool {
 public:
  // False when another thread uses the pool just now.
  bool run(int helpers, Job& job) {
    const std::unique_lock busy(busy_, std::try_to_lock);
    if (!busy) return false;
    {
      const std::lock_guard lock(mutex_);
      for (; started_ < helpers; ++started_) std::thread(&Pool::serve, this, started_, round_.load()).detach();
      job_ = &job;
      helpers_ = running_ = helpers;
      ++round_;
    }
    wake_.notify_all();
    job.run(0);
    const auto finished = [this] { return running_ == 0; };
    look_out(finished);
    std::unique_lock lock(mutex_);
    done_.wait(lock, finished);
    return true;
  }

 private:
  void serve(int index, std::uint64_t seen) {
    for (;;) {
      const auto called = [&] { return round_ != seen; };
      look_out(called);
      std::unique_lock lock(mutex_);
      wake_.wait(lock, called);
      seen = round_;
      if (index >= helpers_) continue;
      Job* job = job_;
      lock.unlock();
      job->run(index + 1);
      lock.lock();
      if (--running_ == 0) done_.notify_one();
    }
  }

  std::mutex busy_, mutex_;
  std::condition_variable wake_, done_;
  Job* job_ = nullptr;
  std::atomic<std::uint64_t> round_{0};
  std::atomic<int> running_{0};
  int started_ = 0, helpers_ = 0;
};

// Never destroyed, since its threads end with the process; a forked child has none of them and gets a pool of its own.
Pool& pool() {
  static std::mutex mutex;
  static Pool* instance = nullptr;
  const std::lock_guard lock(mutex);
#if defined(__unix__) || defined(__APPLE__)
  static pid_t owner = 0;
  if (owner != getpid()) instance = nullptr;
  owner = getpid();
#endif
  if (!instance) instance = new Pool;
  return *instance;
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
