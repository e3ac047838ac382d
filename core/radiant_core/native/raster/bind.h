// Adds the rasterizer to the Python module.
#pragma once

#include <nanobind/nanobind.h>

namespace radiant {
void bind_raster(nanobind::module_& module);
}
