// Dense inverse depth of one photograph by PatchMatch against neighbouring ones (dense/search.h).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "dense/kernels.h"

namespace radiant {

// The build of that name, the fastest for an empty name, null for one that this CPU cannot run.
const DenseKernels* find_dense_kernels(const std::string& name);

// Four neighbouring pixels in a word, for all pixels of a grey image (H,W) but the last row and
// column, which repeat.
std::vector<std::uint32_t> grey_quads(const std::uint8_t* grey, int width, int height);

// Planes and costs (R,C) of a lattice, in place: `planes` (3,R,C) hold the best of `num_candidates`
// sets (Q,3,R,C) after `passes`. `job` without its planes.
void match_planes(DepthJob job, const float* candidates, std::int64_t num_candidates, const std::vector<DepthPass>& passes, float* planes,
                  float* costs, const DenseKernels& kernels, int num_threads);

}  // namespace radiant
