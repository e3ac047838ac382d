// The Python border of comparing descriptors.
#pragma once

#include <nanobind/nanobind.h>

void bind_matching(nanobind::module_& module);
