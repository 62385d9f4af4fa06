// Python's robust_error and normal_equations.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_alignment(nanobind::module_& module);

}  // namespace lfnav
