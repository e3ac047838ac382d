// What the kernels that compare descriptors work on, and their table. Plain data:
// matching/kernels.cpp is compiled per instruction set and includes no standard header's templates.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace radiant {

constexpr int kDescriptorBytes = 128;
// Descriptors that are compared with one at a time, whatever the registers hold.
constexpr int kGroup = 16;

// The products a . b of N descriptors with M others. `packed` holds the others as the kernels'
// `pack` lays them out; all lengths but `num_queries` are rounded up to whole groups.
struct ProductsJob {
  const uint8_t* queries;  // (N,128)
  int64_t num_queries;
  const void* packed;
  int64_t num_groups;
  int32_t* best;         // (N,) greatest product of each query
  int32_t* second;       // (N,) greatest one with another descriptor than that of `best`
  int32_t* best_index;   // (N,) whose product is `best`, the smallest index of equal ones
  int32_t* column_best;  // (M,) greatest product of each of the others, 0 at first
};

struct MatchingKernels {
  const char* name;
  int64_t bytes_per_group;
  // Lays out (M,128) descriptors in `num_groups` groups, zeros behind the last.
  void (*pack)(const uint8_t* descriptors, int64_t count, int64_t num_groups, void* packed);
  void (*compare)(const ProductsJob& job);
};

}  // namespace radiant
