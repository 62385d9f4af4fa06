// The normal equations of direct image alignment, of one rendered view and one camera image.

#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "image.hpp"
#include "instruction_set.hpp"
#include "photometry.hpp"

namespace lfnav {

/// Focal lengths and principal point, pixels.
struct Pinhole {
    double fx, fy, cx, cy;
};

/// How surface points move against the camera, in its axes, when an unknown grows by a unit: seen
/// on the ray r at inverse depth d, by -(rotation x r + d translation), times their depth.
struct Motion {
    std::array<double, 3> rotation, translation;
};

/// More unknowns than these no pose has.
constexpr std::size_t MOST_UNKNOWNS = 6;

/// A view as the normal equations see it.
struct AlignedView {
    /// Rendered, and 1 where covered.
    MaskedImage image;
    /// Of the surface.
    ScalarImage inverse_depth;
    /// Camera image, and 1 where it is to be compared.
    MaskedImage target;
    Photometry photometry;
    /// Neighbours that differ by less grey levels say nothing about the pose.
    double flat;
    Pinhole pinhole;
};

/// The weighted normal equations of one comparison; gain and offset are two unknowns more.
///
/// The colour of a surface point is taken to move along with it. A pixel counts where it and its
/// four neighbours are covered.
///
/// @param motions: of the D unknowns of the pose, at most MOST_UNKNOWNS.
/// @param tiles_across: the gradients of so many times so many tiles of the image are kept apart.
/// @param hessian: (D + 2, D + 2) zeros, receives the sum.
/// @param tile_gradients: (tiles, D + 2) zeros, receives the gradient of each tile.
LFNAV_DECLARE(void add_normal_equations(const AlignedView& view, std::span<const Motion> motions,
                                        std::size_t tiles_across, std::span<double> hessian,
                                        std::span<double> tile_gradients))

}  // namespace lfnav
