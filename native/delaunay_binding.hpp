// Python's delaunay_triangles and delaunay_meshes.

#pragma once

#include <nanobind/nanobind.h>

#include "array_argument.hpp"
#include "virtual_views.hpp"

namespace lfnav {

/// @param limits: (4,).
MeshSettings mesh_settings(const ArrayArgument<double>& limits);

void bind_delaunay(nanobind::module_& module);

}  // namespace lfnav
