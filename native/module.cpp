// The Python module pipelines.native; pipelines/native.pyi has its types.

#include <nanobind/nanobind.h>
#include <nanobind/stl/string_view.h>

#include "alignment_binding.hpp"
#include "brightness_binding.hpp"
#include "delaunay_binding.hpp"
#include "instruction_set.hpp"
#include "renderer_binding.hpp"
#include "sampling_limit_binding.hpp"

NB_MODULE(native, module) {
    module.doc() = "The C++ core: what is done for every pixel of every particle.";
    // Now, so that a wrong choice ends the import and not a kernel.
    lfnav::instruction_set();
    module.def(
        "instruction_set", [] { return lfnav::name_of(lfnav::instruction_set()); },
        "Name of the processor's level, of those that the core is compiled for.");
    lfnav::bind_alignment(module);
    lfnav::bind_brightness(module);
    lfnav::bind_delaunay(module);
    lfnav::bind_renderer(module);
    lfnav::bind_sampling_limit(module);
}
