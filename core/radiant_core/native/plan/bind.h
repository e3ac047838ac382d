// The Python border of the planner's kernels.
#pragma once

#include <nanobind/nanobind.h>

void bind_plan(nanobind::module_& module);
