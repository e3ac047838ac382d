// What the kernels of a radiance field's hash grid work on, and their table. Plain data:
// field/kernels.cpp is compiled per instruction set and includes no standard header's templates.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace radiant {

// N places in a grid of L levels, each a table of T pairs; T is a power of two.
struct GridJob {
  const float* places;             // (3,N) in 0..1, clamped
  const float* table;              // (L,T,2)
  const int32_t* resolutions;      // (L) cells a side, 1 to 65,535
  const float* feature_gradients;  // (2L,N), of the two backward kernels
  float* features;                 // (2L,N)
  float* table_gradients;          // (L,T,2), added to
  float* place_gradients;          // (3,N)
  int64_t count, levels, entries;
};

struct FieldKernels {
  const char* name;
  void (*encode_level)(const GridJob& job, int64_t level);
  // Adds the level's share of the table's gradient.
  void (*table_gradient_level)(const GridJob& job, int64_t level);
  // Writes the gradients of the places begin to end, over all levels.
  void (*place_gradients)(const GridJob& job, int64_t begin, int64_t end);
};

}  // namespace radiant
