// Python's fitted_brightness, robust_error and normal_equations.

#include <nanobind/stl/tuple.h>

#include <limits>
#include <tuple>
#include <vector>

#include "arguments.hpp"
#include "bindings.hpp"
#include "brightness.hpp"
#include "normal_equations.hpp"
#include "robust_error.hpp"

namespace nb = nanobind;

namespace lfnav::LFNAV_LEVEL {

namespace {

// Gradients of more tiles than this squared nobody needs, and they would fill the memory.
constexpr std::size_t MOST_TILES_ACROSS = 1024;

Photometry photometry_of(nb::handle gain, nb::handle offset, nb::handle limit) {
    return {finite_number(gain, "gain"), finite_number(offset, "offset"),
            positive_number(limit, "limit")};
}

std::tuple<double, double, double> python_fitted_brightness(nb::handle view, nb::handle target,
                                                            nb::handle stride, nb::handle cutoff,
                                                            nb::handle smallest_scale,
                                                            nb::handle largest_gain) {
    const ArrayArgument<float> rendered(view, "view", {ANY, ANY, 4});
    const ArrayArgument<float> wanted(target, "target", {rendered.shape(0), rendered.shape(1), 4});
    constexpr std::size_t most = std::numeric_limits<std::int32_t>::max();
    const std::size_t step = integer_between(1, most, stride, "stride");
    const BrightnessLimits limits{positive_number(cutoff, "cutoff"),
                                  positive_number(smallest_scale, "smallest_scale"),
                                  number_from(1.0, largest_gain, "largest_gain")};
    const nb::gil_scoped_release unlocked;
    const Brightness found = fitted_brightness(rendered, wanted, step, limits);
    return {found.gain, found.offset, found.scale};
}

double python_robust_error(nb::handle view, nb::handle target, nb::handle gain, nb::handle offset,
                           nb::handle limit) {
    const ArrayArgument<float> rendered(view, "view", {ANY, ANY, 4});
    const ArrayArgument<float> wanted(target, "target", {rendered.shape(0), rendered.shape(1), 4});
    const Photometry photometry = photometry_of(gain, offset, limit);
    const nb::gil_scoped_release unlocked;
    return robust_error(rendered, wanted, photometry);
}

nb::tuple python_normal_equations(const nb::kwargs& arguments) {
    NamedArguments given(arguments);
    const ArrayArgument<float> image(given, "image", {ANY, ANY, 4});
    const std::size_t height = image.shape(0), width = image.shape(1);
    const ArrayArgument<float> inverse_depth(given, "inverse_depth", {height, width});
    const ArrayArgument<float> target(given, "target", {height, width, 4});
    const ArrayArgument<double> intrinsics(given, "intrinsics", {4});
    const ArrayArgument<double> rotation(given, "rotation", {3, 3});
    const ArrayArgument<double> lever(given, "lever", {3});
    const ArrayArgument<double> axes(given, "axes", {ANY, 3});
    const std::size_t unknowns = axes.shape(0);
    if (unknowns > MOST_UNKNOWNS) {
        refuse_value("axes", "at most 6 unknowns expected");
    }
    const ArrayArgument<bool> is_rotation(given, "is_rotation", {unknowns});
    const std::size_t tiles =
        integer_between(1, MOST_TILES_ACROSS, given.take("tiles_across"), "tiles_across");
    const double* const lens = intrinsics.data();
    const AlignedView view{
        image,
        inverse_depth,
        target,
        photometry_of(given.take("gain"), given.take("offset"), given.take("limit")),
        finite_number(given.take("flat"), "flat"),
        {lens[0], lens[1], lens[2], lens[3]}};
    given.end();
    const std::vector<Motion> motions =
        camera_motions(rotation.span(), lever.span(), axes.span(), is_rotation.span());
    NewArray<double> hessian({unknowns + 2, unknowns + 2});
    NewArray<double> tile_gradients({tiles * tiles, unknowns + 2});
    {
        const nb::gil_scoped_release unlocked;
        add_normal_equations(view, motions, tiles, hessian.values, tile_gradients.values);
    }
    return nb::make_tuple(hessian.array, tile_gradients.array);
}

}  // namespace

void bind_alignment(nb::module_& module) {
    module.def("fitted_brightness", &python_fitted_brightness, argument("view"), argument("target"),
               argument("stride"), argument("cutoff"), argument("smallest_scale"),
               argument("largest_gain"));
    module.def("robust_error", &python_robust_error, argument("view"), argument("target"),
               argument("gain"), argument("offset"), argument("limit"));
    module.def("normal_equations", &python_normal_equations);
}

}  // namespace lfnav::LFNAV_LEVEL
