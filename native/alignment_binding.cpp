#include "alignment_binding.hpp"

#include <array>
#include <limits>
#include <vector>

#include "array_argument.hpp"
#include "normal_equations.hpp"
#include "robust_error.hpp"

namespace nb = nanobind;

namespace lfnav {

namespace {

// Gradients of more tiles than this squared nobody needs, and they would fill the memory.
constexpr std::size_t MOST_TILES_ACROSS = 1024;

Photometry photometry_of(nb::handle gain, nb::handle offset, nb::handle limit) {
    return {finite_number(gain, "gain"), finite_number(offset, "offset"),
            positive_number(limit, "limit")};
}

/// Motions of surface points against the camera.
///
/// A point at offset Y from the camera's centre, in its axes, moves by -R^T (dp + w x (X - p)) when
/// the body at p is shifted by dp and rotated by w; divided by its depth this stays finite for
/// points far away.
///
/// @param rotation: (3, 3) R of world_from_camera.
/// @param lever: (3,) from the body's origin to the camera's centre, world axes.
/// @param axes: (D, 3) world axis of each unknown.
/// @param is_rotation: (D,) whether the unknown is a rotation about its axis, or a shift along it.
std::vector<Motion> camera_motions(std::span<const double> rotation, std::span<const double> lever,
                                   std::span<const double> axes,
                                   std::span<const bool> is_rotation) {
    std::vector<Motion> motions(is_rotation.size());
    for (std::size_t k = 0; k < motions.size(); ++k) {
        const double* const axis = &axes[3 * k];
        for (std::size_t i = 0; i < 3; ++i) {
            double own = 0.0, arm = 0.0;
            for (std::size_t j = 0; j < 3; ++j) {
                own += rotation[3 * j + i] * axis[j];
                // The cross product of axis and lever.
                const std::size_t p = (j + 1) % 3, q = (j + 2) % 3;
                arm += rotation[3 * j + i] * (axis[p] * lever[q] - axis[q] * lever[p]);
            }
            motions[k].rotation[i] = is_rotation[k] ? own : 0.0;
            motions[k].translation[i] = is_rotation[k] ? arm : own;
        }
    }
    return motions;
}

double python_robust_error(nb::handle view, nb::handle target, nb::handle gain, nb::handle offset,
                           nb::handle limit) {
    const MaskedImageArgument rendered(view, "view");
    const MaskedImageArgument wanted(target, "target", rendered);
    const Photometry photometry = photometry_of(gain, offset, limit);
    const nb::gil_scoped_release unlocked;
    return LFNAV_BEST(robust_error)(rendered, wanted, photometry);
}

nb::tuple python_normal_equations(nb::handle image, nb::handle inverse_depth, nb::handle target,
                                  nb::handle gain, nb::handle offset, nb::handle limit,
                                  nb::handle flat, nb::handle intrinsics, nb::handle rotation,
                                  nb::handle lever, nb::handle axes, nb::handle is_rotation,
                                  nb::handle tiles_across) {
    const MaskedImageArgument own(image, "image");
    const MaskedImage rendered = own;
    const ArrayArgument<float> depth(inverse_depth, "inverse_depth",
                                     {rendered.height, rendered.width});
    const MaskedImageArgument wanted(target, "target", rendered);
    const ArrayArgument<double> pinhole(intrinsics, "intrinsics", {4});
    const ArrayArgument<double> turned(rotation, "rotation", {3, 3});
    const ArrayArgument<double> arm(lever, "lever", {3});
    const ArrayArgument<double> directions(axes, "axes", {ANY, 3});
    const std::size_t unknowns = directions.shape(0);
    if (unknowns > MOST_UNKNOWNS) {
        refuse_value("axes", "at most 6 unknowns expected");
    }
    const ArrayArgument<bool> kinds(is_rotation, "is_rotation", {unknowns});
    const std::size_t tiles = integer_between(1, MOST_TILES_ACROSS, tiles_across, "tiles_across");
    const double* const lens = pinhole.data();
    const AlignedView view{rendered,
                           {depth.data(), rendered.height, rendered.width},
                           wanted,
                           photometry_of(gain, offset, limit),
                           finite_number(flat, "flat"),
                           {lens[0], lens[1], lens[2], lens[3]}};
    const std::vector<Motion> motions =
        camera_motions(turned.span(), arm.span(), directions.span(), kinds.span());
    NewArray<double> hessian({unknowns + 2, unknowns + 2});
    NewArray<double> tile_gradients({tiles * tiles, unknowns + 2});
    {
        const nb::gil_scoped_release unlocked;
        LFNAV_BEST(add_normal_equations)(view, motions, tiles, hessian.values,
                                         tile_gradients.values);
    }
    return nb::make_tuple(hessian.array, tile_gradients.array);
}

}  // namespace

void bind_alignment(nb::module_& module) {
    module.def("robust_error", &python_robust_error, argument("view"), argument("target"),
               argument("gain"), argument("offset"), argument("limit"));
    module.def("normal_equations", &python_normal_equations, argument("image"),
               argument("inverse_depth"), argument("target"), argument("gain"), argument("offset"),
               argument("limit"), argument("flat"), argument("intrinsics"), argument("rotation"),
               argument("lever"), argument("axes"), argument("is_rotation"),
               argument("tiles_across"));
}

}  // namespace lfnav
