// Python's PlaneScene.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_plane_renderer(nanobind::module_& module);

}  // namespace lfnav
