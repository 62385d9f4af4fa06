// Python's fitted_brightness.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_brightness(nanobind::module_& module);

}  // namespace lfnav
