// Depth that is smooth except across edges of the image: semi-global matching (Hirschmueller 2008).

#pragma once

#include <cstddef>
#include <cstdint>

#include "image.hpp"
#include "instruction_set.hpp"

namespace lfnav {

/// What it costs that neighbouring pixels lie on different planes.
struct DepthPenalties {
    /// One plane apart; further apart; grey levels between the pixels at which a jump costs half.
    float step, jump, edge_contrast;
    /// A jump costs at least this.
    float least_jump;
};

/// Finds the plane of each pixel along eight paths, winner takes all.
///
/// @param volume: (H, W, D) costs, D at least 1.
/// @param index: (H, W) receives the plane's number, with a fraction.
/// @param distinctness: (H, W) receives how much less it costs than the average plane.
LFNAV_DECLARE(void semi_global_matching(const std::uint8_t* volume, std::size_t planes,
                                        const GreyImage& reference, const DepthPenalties& penalties,
                                        float* index, float* distinctness))

}  // namespace lfnav
