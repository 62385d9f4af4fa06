// The function of pipelines.native for densities of mixtures.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_mixture_density(nanobind::module_& module);

}  // namespace lfnav
