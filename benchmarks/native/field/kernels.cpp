// A multiresolution hash grid (Mueller et al. 2022), trilinear: features, and the gradients of its
// table and of the places. Once per step for some hundred thousand places.
//
//   feature = sum over the 8 corners of a cell of  w_c table[index_c],  w_c = prod of f or 1 - f
//   index   = x + (R+1) (y + (R+1) z) where a level has room for all its (R+1)^3 corners,
//             (x ^ 2654435761 y ^ 805459861 z) mod T else
//
// Level by level, so that one level's table stays in the cache. Nothing here may come from a
// standard header's templates: the linker keeps one copy of those.
#include "field/kernels.h"

#define RADIANT_INLINE inline __attribute__((always_inline))

namespace radiant::field::RADIANT_ISA {

constexpr int kLanes = 16;

struct Cells {
  uint32_t low[3][kLanes];
  float share[3][kLanes];
};

struct Level {
  uint32_t side, mask;
  float resolution;
  bool hashed;
};

RADIANT_INLINE Level level_of(const GridJob& job, int64_t level) {
  const uint32_t side = static_cast<uint32_t>(job.resolutions[level]) + 1;
  const bool hashed = static_cast<uint64_t>(side) * side * side > static_cast<uint64_t>(job.entries);
  return {side, static_cast<uint32_t>(job.entries - 1), static_cast<float>(job.resolutions[level]), hashed};
}

// The cells of up to 16 places; lanes beyond `lanes` repeat the last one.
RADIANT_INLINE void find_cells(const GridJob& job, int64_t first, int lanes, const Level& level, Cells& cells) {
  for (int axis = 0; axis < 3; ++axis) {
    const float* from = job.places + axis * job.count + first;
    float place[kLanes];
    for (int i = 0; i < kLanes; ++i) place[i] = from[i < lanes ? i : lanes - 1];
    for (int i = 0; i < kLanes; ++i) {
      const float inside = place[i] > 0 ? (place[i] < 1 ? place[i] : 1) : 0, scaled = inside * level.resolution;
      const int32_t whole = static_cast<int32_t>(scaled), last = static_cast<int32_t>(level.side) - 2;
      const int32_t low = whole < last ? whole : last;
      cells.low[axis][i] = static_cast<uint32_t>(low);
      cells.share[axis][i] = scaled - static_cast<float>(low);
    }
  }
}

RADIANT_INLINE void find_corner(const Level& level, const Cells& cells, int corner, uint32_t index[kLanes], float weight[kLanes]) {
  const uint32_t dx = corner & 1, dy = corner >> 1 & 1, dz = corner >> 2;
  for (int i = 0; i < kLanes; ++i) {
    const float fx = cells.share[0][i], fy = cells.share[1][i], fz = cells.share[2][i];
    weight[i] = (dx ? fx : 1 - fx) * (dy ? fy : 1 - fy) * (dz ? fz : 1 - fz);
  }
  if (level.hashed) {
    for (int i = 0; i < kLanes; ++i)
      index[i] = ((cells.low[0][i] + dx) ^ (cells.low[1][i] + dy) * 2654435761u ^ (cells.low[2][i] + dz) * 805459861u) & level.mask;
  } else {
    for (int i = 0; i < kLanes; ++i)
      index[i] = cells.low[0][i] + dx + level.side * (cells.low[1][i] + dy + level.side * (cells.low[2][i] + dz));
  }
}

inline void encode_level(const GridJob& job, int64_t number) {
  const Level level = level_of(job, number);
  const float* table = job.table + 2 * number * job.entries;
  float* out = job.features + 2 * number * job.count;
  for (int64_t first = 0; first < job.count; first += kLanes) {
    const int lanes = job.count - first < kLanes ? static_cast<int>(job.count - first) : kLanes;
    Cells cells;
    find_cells(job, first, lanes, level, cells);
    float sums[2][kLanes] = {};
    for (int corner = 0; corner < 8; ++corner) {
      uint32_t index[kLanes];
      float weight[kLanes];
      find_corner(level, cells, corner, index, weight);
      for (int i = 0; i < kLanes; ++i) {
        sums[0][i] += weight[i] * table[2 * index[i]];
        sums[1][i] += weight[i] * table[2 * index[i] + 1];
      }
    }
    for (int i = 0; i < lanes; ++i) out[first + i] = sums[0][i];
    for (int i = 0; i < lanes; ++i) out[job.count + first + i] = sums[1][i];
  }
}

inline void table_gradient_level(const GridJob& job, int64_t number) {
  const Level level = level_of(job, number);
  float* table = job.table_gradients + 2 * number * job.entries;
  const float* in = job.feature_gradients + 2 * number * job.count;
  for (int64_t first = 0; first < job.count; first += kLanes) {
    const int lanes = job.count - first < kLanes ? static_cast<int>(job.count - first) : kLanes;
    Cells cells;
    find_cells(job, first, lanes, level, cells);
    for (int corner = 0; corner < 8; ++corner) {
      uint32_t index[kLanes];
      float weight[kLanes];
      find_corner(level, cells, corner, index, weight);
      // One after another: two places may share a corner.
      for (int i = 0; i < lanes; ++i) {
        table[2 * index[i]] += weight[i] * in[first + i];
        table[2 * index[i] + 1] += weight[i] * in[job.count + first + i];
      }
    }
  }
}

inline void place_gradients_level(const GridJob& job, int64_t number, int64_t first, int lanes, float sums[3][kLanes]) {
  const Level level = level_of(job, number);
  const float* table = job.table + 2 * number * job.entries;
  const float* in = job.feature_gradients + 2 * number * job.count + first;
  Cells cells;
  find_cells(job, first, lanes, level, cells);
  for (int corner = 0; corner < 8; ++corner) {
    uint32_t index[kLanes];
    float weight[kLanes];
    find_corner(level, cells, corner, index, weight);
    for (int i = 0; i < lanes; ++i) {
      const float pull = level.resolution * (table[2 * index[i]] * in[i] + table[2 * index[i] + 1] * in[job.count + i]);
      for (int axis = 0; axis < 3; ++axis) {
        float slope = corner >> axis & 1 ? 1.0f : -1.0f;
        for (int other = 0; other < 3; ++other) {
          const float share = cells.share[other][i];
          if (other != axis) slope *= corner >> other & 1 ? share : 1 - share;
        }
        sums[axis][i] += slope * pull;
      }
    }
  }
}

inline void place_gradients(const GridJob& job, int64_t begin, int64_t end) {
  for (int64_t first = begin; first < end; first += kLanes) {
    const int lanes = end - first < kLanes ? static_cast<int>(end - first) : kLanes;
    float sums[3][kLanes] = {};
    for (int64_t level = 0; level < job.levels; ++level) place_gradients_level(job, level, first, lanes, sums);
    for (int axis = 0; axis < 3; ++axis)
      for (int i = 0; i < lanes; ++i) job.place_gradients[axis * job.count + first + i] = sums[axis][i];
  }
}

#define RADIANT_TEXT_OF(name) #name
#define RADIANT_TEXT(name) RADIANT_TEXT_OF(name)

extern const FieldKernels kernels;
const FieldKernels kernels = {RADIANT_TEXT(RADIANT_ISA), encode_level, table_gradient_level, place_gradients};

}  // namespace radiant::field::RADIANT_ISA
