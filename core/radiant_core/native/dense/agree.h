// Which nodes of one photograph's planes other photographs agree on, and the sums of their points.
#pragma once

#include <cstdint>
#include <vector>

namespace radiant {

// A photograph's camera and its planes of inverse depth (3,R,C) on a lattice whose node (r, c) is
// the pixel first + step (c, r).
struct PlaneView {
  const float* planes;
  std::int64_t rows, columns;
  double first, step;
  double focal_x, focal_y, center_x, center_y;
  double pose[12];  // camera from world, 3 rows of 4
};

struct AgreeLimits {
  double cost;    // a node that costs as much or more is no match
  double pixels;  // between a node and another photograph's point seen from its camera
  double depths;  // relative
};

// Adds up each node's own point X and those of the photographs that agree with it, in the world:
// such a photograph has a plane where it sees X, whose point there has X's pixel and depth again.
// sums (R C,3), counts (R C,) of those that agree; both 0 where a node has no plane of finite
// slopes or costs too much.
void sum_agreeing(const PlaneView& own, const float* costs, const std::vector<PlaneView>& others, const AgreeLimits& limits, double* sums,
                  std::int32_t* counts);

}  // namespace radiant
