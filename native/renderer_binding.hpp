// Python's LightField.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_renderer(nanobind::module_& module);

}  // namespace lfnav
