// Python's added_samples.

#pragma once

#include <nanobind/nanobind.h>

namespace lfnav {

void bind_sampling_limit(nanobind::module_& module);

}  // namespace lfnav
