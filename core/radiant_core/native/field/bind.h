#pragma once

#include <nanobind/nanobind.h>

// Adds the hash grid of radiance fields to the module.
void bind_field(nanobind::module_& module);
