// The Python border of the training loss and of Adam.
#pragma once

#include <nanobind/nanobind.h>

void bind_training(nanobind::module_& module);

// Of the rows that machines exchange which train together.
void bind_rows(nanobind::module_& module);
