// How well photos agree that a pixel shows a surface at each of many depths: a plane sweep
// (Collins 1996), as pipelines/lightfield/stereo_depth.py explains it.

#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "image.hpp"
#include "instruction_set.hpp"

namespace lfnav {

/// A photo that the reference is compared with: the reference's pixel (x, y) at inverse depth q is
/// at its homogeneous pixel map (x, y, 1, q).
struct SweptPhoto {
    GreyImage image;
    /// (3, 4).
    const double* map;
};

/// Fills the matching volume: the cost of each pixel on each plane, 0 (alike) to 240.
///
/// Windows of 3 x 3 pixels, less the grey of their centres, are compared. On a plane on which no
/// photo shows a pixel, it costs what it costs on the others on average.
///
/// @param inverse_depths: (D,) of the planes.
/// @param best: a pixel's cost is the mean of so many of its lowest ones.
/// @param saturation: grey levels; larger differences all cost the same.
/// @param volume: (H, W, D).
LFNAV_DECLARE(void plane_sweep(const GreyImage& reference, std::span<const SweptPhoto> photos,
                               std::span<const double> inverse_depths, std::size_t best,
                               float saturation, std::uint8_t* volume))

}  // namespace lfnav
