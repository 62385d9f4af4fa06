// Python's log_mixture_density.

#include "arguments.hpp"
#include "bindings.hpp"
#include "mixture_density.hpp"

namespace nb = nanobind;

namespace lfnav::LFNAV_LEVEL {

namespace {

nb::object python_log_mixture_density(nb::handle positions, nb::handle centres, nb::handle angles,
                                      nb::handle log_weights, nb::handle position_sigma,
                                      nb::handle angle_sigma) {
    const ArrayArgument<double> places(positions, "positions", {ANY, ANY});
    const ArrayArgument<double> of(centres, "centres", {ANY, places.shape(1)});
    const ArrayArgument<double> turned(angles, "angles", {places.shape(0), of.shape(0)});
    const ArrayArgument<double> weights(log_weights, "log_weights", {of.shape(0)});
    const Mixture mixture{of.shape(0),
                          of.shape(1),
                          of.data(),
                          weights.data(),
                          positive_number(position_sigma, "position_sigma"),
                          positive_number(angle_sigma, "angle_sigma")};
    NewArray<double> result({places.shape(0)});
    {
        const nb::gil_scoped_release unlocked;
        log_mixture_density(mixture, places.shape(0), places.data(), turned.data(),
                            result.values.data());
    }
    return nb::cast(result.array);
}

}  // namespace

void bind_mixture_density(nb::module_& module) {
    module.def("log_mixture_density", &python_log_mixture_density, argument("positions"),
               argument("centres"), argument("angles"), argument("log_weights"),
               argument("position_sigma"), argument("angle_sigma"));
}

}  // namespace lfnav::LFNAV_LEVEL
