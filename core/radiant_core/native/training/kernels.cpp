// The kernels of training for one instruction set, RADIANT_ISA; CMakeLists compiles it for each.
//
// Nothing here may come from a standard header's templates: the linker keeps one copy of those, and
// it might be one that the CPU cannot run.
#include "training/kernels.h"

#include <string.h>

#define RADIANT_INLINE inline __attribute__((always_inline))

namespace radiant::training::RADIANT_ISA {

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

typedef float V __attribute__((vector_size(4 * kLanes)));
typedef int32_t Bits __attribute__((vector_size(4 * kLanes)));
typedef float Loose __attribute__((vector_size(4 * kLanes), aligned(4), may_alias));

RADIANT_INLINE V broadcast(float value) { return value - V{}; }
RADIANT_INLINE V loaded(const float* from) { return *reinterpret_cast<const Loose*>(from); }
RADIANT_INLINE void store(float* to, V value) { *reinterpret_cast<Loose*>(to) = value; }
RADIANT_INLINE void store_part(float* to, V value, int count) { memcpy(to, &value, sizeof(float) * count); }
RADIANT_INLINE V larger(V a, V b) { return a > b ? a : b; }
RADIANT_INLINE V smaller(V a, V b) { return a < b ? a : b; }
RADIANT_INLINE V absolute(V a) { return (V)((Bits)a & 0x7fffffff); }

struct WholeLoad {
  RADIANT_INLINE V operator()(const float* from) const { return loaded(from); }
};

// The last values of a row; zeros beyond them.
struct PartLoad {
  int count;
  RADIANT_INLINE V operator()(const float* from) const {
    V value = {};
    memcpy(&value, from, sizeof(float) * count);
    return value;
  }
};

RADIANT_INLINE double added(V values) {
  double sum = 0;
  for (int i = 0; i < kLanes; ++i) sum += values[i];
  return sum;
}

}  // namespace radiant::training::RADIANT_ISA

#include "training/adam_kernels.h"
#include "training/loss_kernels.h"

#define RADIANT_TEXT_OF(name) #name
#define RADIANT_TEXT(name) RADIANT_TEXT_OF(name)

namespace radiant::training::RADIANT_ISA {

extern const TrainingKernels kernels;
const TrainingKernels kernels = {RADIANT_TEXT(RADIANT_ISA), loss_scratch, loss_rows, statistics_rows, adam_rows, rows_beyond};

}  // namespace radiant::training::RADIANT_ISA
