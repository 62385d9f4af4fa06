// The parts of the Python module. Each is compiled for all levels, along with its kernels.

#pragma once

#include <nanobind/nanobind.h>

#include "instruction_set.hpp"

namespace lfnav {

LFNAV_DECLARE(void bind_alignment(nanobind::module_& module))
LFNAV_DECLARE(void bind_delaunay(nanobind::module_& module))
LFNAV_DECLARE(void bind_depth(nanobind::module_& module))
LFNAV_DECLARE(void bind_mixture_density(nanobind::module_& module))
LFNAV_DECLARE(void bind_renderer(nanobind::module_& module))

}  // namespace lfnav
