// The Python module pipelines.native; pipelines/native.pyi has its types.

#include <nanobind/nanobind.h>
#include <nanobind/stl/string_view.h>

#include "instruction_set.hpp"

NB_MODULE(native, module) {
    module.doc() = "The C++ core: what is done for every pixel of every particle.";
    module.def("instruction_set", &lfnav::instruction_set,
               "Name of the processor's level, of those that the core is compiled for.");
}
