// The Python module pipelines.native; pipelines/native.pyi has its types.

#include <nanobind/nanobind.h>
#include <nanobind/stl/string_view.h>

#include <stdexcept>

#include "bindings.hpp"
#include "instruction_set.hpp"

namespace {

namespace nb = nanobind;

/// Looks at the processor's level now, so that a wrong choice ends the import and not a kernel: as
/// an error of lfnav's, which Python hands over as the cause of an ImportError.
void check_instruction_set() {
    try {
        lfnav::instruction_set();
    } catch (const std::invalid_argument& error) {
        const nb::object type =
            nb::module_::import_("pipelines.artifacts.errors").attr("OptionError");
        PyErr_SetString(type.ptr(), error.what());
        throw nb::python_error();
    }
}

}  // namespace

NB_MODULE(native, module) {
    using namespace lfnav;
    module.doc() = "The C++ core: what is done for every pixel of every particle.";
    check_instruction_set();
    module.def(
        "instruction_set", [] { return name_of(instruction_set()); },
        "Name of the processor's level, of those that the core is compiled for.");
    LFNAV_BEST(bind_alignment)(module);
    LFNAV_BEST(bind_delaunay)(module);
    LFNAV_BEST(bind_depth)(module);
    LFNAV_BEST(bind_mixture_density)(module);
    LFNAV_BEST(bind_renderer)(module);
}
