#include "sampling_limit_binding.hpp"

#include "array_argument.hpp"
#include "sampling_limit.hpp"

namespace nb = nanobind;

namespace lfnav {

namespace {

nb::object python_added_samples(nb::handle texels, nb::handle upper, nb::handle lower,
                                nb::handle fraction, nb::handle upper_weight,
                                nb::handle lower_weight, nb::handle times) {
    const ArrayArgument<std::uint8_t> colours(texels, "texels", {-1, 4});
    const ArrayArgument<std::int32_t> above(upper, "upper", {-1});
    const auto count = static_cast<std::ptrdiff_t>(above.shape(0));
    const ArrayArgument<std::int32_t> below(lower, "lower", {count});
    const ArrayArgument<float> right(fraction, "fraction", {count});
    const ArrayArgument<float> weights(upper_weight, "upper_weight", {count});
    const ArrayArgument<float> weights_below(lower_weight, "lower_weight", {count});
    // A texel to the right of each is read, too.
    const auto end = static_cast<std::int64_t>(colours.shape(0)) - 1;
    check_range(above.span(), 0, end, "upper");
    check_range(below.span(), 0, end, "lower");
    const std::size_t turns = integer_between(1, 1 << 20, times, "times");
    const GivenSamples samples{colours.data(),
                               above.data(),
                               below.data(),
                               right.data(),
                               weights.data(),
                               weights_below.data(),
                               above.shape(0) / GivenSamples::EACH};
    NewArray<float> image({samples.pixels, 4});
    {
        const nb::gil_scoped_release unlocked;
        LFNAV_BEST(add_given_samples)(samples, turns, image.values.data());
    }
    return nb::cast(image.array);
}

}  // namespace

void bind_sampling_limit(nb::module_& module) {
    module.def("added_samples", &python_added_samples, argument("texels"), argument("upper"),
               argument("lower"), argument("fraction"), argument("upper_weight"),
               argument("lower_weight"), argument("times"));
}

}  // namespace lfnav
