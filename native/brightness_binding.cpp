#include "brightness_binding.hpp"

#include <nanobind/stl/tuple.h>

#include <limits>
#include <tuple>

#include "array_argument.hpp"
#include "brightness.hpp"

namespace nb = nanobind;

namespace lfnav {

void bind_brightness(nb::module_& module) {
    module.def(
        "fitted_brightness",
        [](nb::handle view, nb::handle target, nb::handle stride, nb::handle cutoff,
           nb::handle smallest_scale, nb::handle largest_gain) {
            const MaskedImageArgument rendered(view, "view");
            const MaskedImageArgument wanted(target, "target", rendered);
            constexpr std::size_t most = std::numeric_limits<std::int32_t>::max();
            const std::size_t step = integer_between(1, most, stride, "stride");
            const BrightnessLimits limits{positive_number(cutoff, "cutoff"),
                                          positive_number(smallest_scale, "smallest_scale"),
                                          number_from(1.0, largest_gain, "largest_gain")};
            const nb::gil_scoped_release unlocked;
            const Brightness found = LFNAV_BEST(fitted_brightness)(rendered, wanted, step, limits);
            return std::make_tuple(found.gain, found.offset, found.scale);
        },
        argument("view"), argument("target"), argument("stride"), argument("cutoff"),
        argument("smallest_scale"), argument("largest_gain"));
}

}  // namespace lfnav
