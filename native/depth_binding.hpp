// The functions of pipelines.native that make depth maps.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_depth(nanobind::module_& module);

}  // namespace lfnav
