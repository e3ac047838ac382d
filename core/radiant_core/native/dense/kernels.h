// What the kernels of dense depth work on, and their table. Plain data: dense/kernels.cpp is
// compiled per instruction set and includes no standard header's templates.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace radiant {

constexpr int kMaxSources = 8;

// One neighbouring photograph: p' = matrix (x, y, 1) + offset w takes the pixel (x, y) of the
// reference at inverse depth w to homogeneous pixels of the source. Pixels count from the middle of
// the first one.
struct DepthSource {
  // (H,W) grey of pixels (y,x), (y,x+1), (y+1,x), (y+1,x+1), lowest byte first
  const uint32_t* quads;
  int32_t width, height;
  float matrix[9], offset[3];
};

// Planes w + a dx + b dy of inverse depth about each node of a lattice; rows of `stride` floats.
struct PlaneRows {
  float* inverse_depths;
  float* across;
  float* down;
  float* costs;
};

struct DepthJob {
  const uint8_t* reference;  // (H,W) grey
  int32_t width, height;
  const DepthSource* sources;
  int32_t num_sources;
  int64_t rows, columns, stride;  // of the lattice; node (r, c) is the pixel first + step (c, r)
  float first, step;
  float focal_x, focal_y, center_x, center_y;  // of the reference
  float least, most;                           // inverse depth
  float min_cosine;                            // between the plane's normal and the line of sight
  float pixel;  // change of inverse depth that moves it by a pixel in a source
  PlaneRows from, to;                          // what a pass reads and writes
};

// A pass over the lattice: planes of nodes around and random changes compete with the own one.
struct DepthPass {
  int32_t reach;       // nodes at this distance are tried beside the direct neighbours; 0: none
  float amplitude_px;  // size of the random changes; 0: none
  uint32_t seed;
};

struct DenseKernels {
  const char* name;
  // Replaces the planes and costs of rows begin to end of `to` by candidates (3, R, stride) where
  // they cost less.
  void (*try_rows)(const DepthJob& job, const float* candidates, int64_t begin, int64_t end);
  void (*pass_rows)(const DepthJob& job, const DepthPass& pass, int64_t begin, int64_t end);
};

}  // namespace radiant
