// Front-to-back order of the entries of one tile.
#pragma once

#include <cstddef>
#include <cstdint>

#include "raster/types.h"

namespace radiant {

// Stable sort by depth key; `spare` holds as many entries. O(count) for long lists.
void sort_by_depth(Entry* entries, Entry* spare, std::size_t count);

}  // namespace radiant
