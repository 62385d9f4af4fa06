// Depth maps of neighbouring views brought to agree (Merrell and others 2007), as
// pipelines/lightfield/depth_filtering.py explains it.

#pragma once

#include <cstddef>
#include <span>

#include "image.hpp"
#include "instruction_set.hpp"

namespace lfnav {

/// What another view found.
struct NeighbourDepth {
    ScalarImage inverse_depth;
    const bool* confident;
    /// (3, 4) from its pixel (x, y) at inverse depth q to the view's homogeneous pixel
    /// map (x, y, 1, q), and from the view to it.
    const double *to_view, *from_view;
};

/// Takes at each pixel the depth that most neighbours see and fewest see through, and averages all
/// depths that agree with it.
///
/// @param own: the view's inverse depths; 0, as in all maps: none.
/// @param unsure_trust: what a neighbour's depth counts where it is not confident; else 1.
/// @param agreement: share of the inverse depth within which depths are of the same surface.
/// @param fused: (H, W) receives inverse depths.
/// @param votes: (H, W) receives neighbours that see the surface less those that see through it.
LFNAV_DECLARE(void fuse_depth(const ScalarImage& own, std::span<const NeighbourDepth> neighbours,
                              float unsure_trust, double agreement, float* fused, float* votes))

}  // namespace lfnav
