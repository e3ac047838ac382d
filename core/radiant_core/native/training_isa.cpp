#include "training_isa.h"

#include <algorithm>
#include <exception>
#include <system_error>
#include <thread>

namespace radiant {

namespace training::portable { extern const TrainingKernels kernels; }
#ifdef RADIANT_X86
namespace training::avx2 { extern const TrainingKernels kernels; }
namespace training::avx512 { extern const TrainingKernels kernels; }
#endif

const std::vector<const TrainingKernels*>& training_kernels() {
  static const std::vector<const TrainingKernels*> usable = [] {
    std::vector<const TrainingKernels*> found;
#ifdef RADIANT_X86
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512bw"))
      found.push_back(&training::avx512::kernels);
    if (avx2) found.push_back(&training::avx2::kernels);
#endif
    found.push_back(&training::portable::kernels);
    return found;
  }();
  return usable;
}

const TrainingKernels* training_kernels(const std::string& name) {
  for (const TrainingKernels* kernels : training_kernels()) {
    if (name.empty() || name == kernels->name) return kernels;
  }
  return nullptr;
}

void share_rows(int num_threads, std::int64_t num_rows, std::int64_t min_rows, const std::function<void(std::int64_t, std::int64_t)>& work) {
  const std::int64_t parts = std::clamp<std::int64_t>(num_rows / std::max<std::int64_t>(min_rows, 1), 1, std::max(num_threads, 1));
  const auto border = [&](std::int64_t part) { return num_rows * part / parts; };
  // An exception must not leave a thread, and a range whose thread cannot be started is done here.
  std::vector<std::exception_ptr> failures(parts);
  const auto run = [&](std::int64_t part) {
    try {
      work(border(part), border(part + 1));
    } catch (...) {
      failures[part] = std::current_exception();
    }
  };
  std::vector<std::thread> threads;
  std::int64_t started = 1;
  try {
    for (threads.reserve(parts - 1); started < parts; ++started) threads.emplace_back(run, started);
  } catch (const std::system_error&) {
  }
  run(0);
  for (std::int64_t part = started; part < parts; ++part) run(part);
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& failure : failures) {
    if (failure) std::rethrow_exception(failure);
  }
}

}  // namespace radiant
