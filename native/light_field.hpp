// A light field as the renderer reads it: what the records of pipelines.lightfield hold.

#pragma once

#include <cstddef>
#include <cstdint>

namespace lfnav {

/// N posed pinhole photos; see ViewArrays in pipelines/lightfield/views.py.
struct Photos {
    std::size_t count, levels;
    /// (T, 4) all pyramid levels of all photos, and so many more that one to the right of a texel
    /// and one below it are always there.
    const std::uint8_t* texels;
    /// (N, L) index of a level's first texel.
    const std::int64_t* level_start;
    /// (N, L, 2) width and height of each level; level 0 is the finest.
    const std::int64_t* level_size;
    /// (N, 3, 4) world points to homogeneous pixels of level 0.
    const double* projection;
    /// (N, 3) recording centres.
    const double* centres;
    /// (N,) mean focal length of level 0, pixels.
    const double* focal;
    /// (N,) which photos may take part.
    const bool* usable;
    /// (N, 3, 3) homogeneous pixels of level 0 to world directions, of length 1 along the axis.
    const double* rays;
    /// All depth maps: 1 / metres, where each begins, and (N, 2) width and height, 0: none.
    const float* inverse_depth;
    const std::int64_t *depth_start, *depth_size;
    /// The largest inverse depths in squares of them, and where each map's begin.
    static constexpr std::int64_t POOLING = 4;
    const float* pooled;
    const std::int64_t* pooled_start;
    /// Whether any photo has a depth map.
    bool has_depth;
    /// By so much something has to be nearer than a point to hide it.
    float occlusion_factor;

    /// (2,) width and height of a photo's finest level.
    const std::int64_t* size_of(std::size_t photo) const { return level_size + 2 * levels * photo; }
};

/// The usable photos, and the groups that neighbours form; see ViewIndex in
/// pipelines/render/candidate_views.py.
struct PhotoIndex {
    static constexpr std::size_t GROUP_PHOTOS = 16, PHOTO_NUMBERS = 18, GROUP_NUMBERS = 20;

    std::size_t count, groups;
    /// (3,) of the coordinates in which all else is given.
    const double* origin;
    /// (S,) the photos, rising.
    const std::int32_t* order;
    /// (S, PHOTO_NUMBERS) projection, centre, width, height, width of the strip along the border.
    const float* numbers;
    /// (G, GROUP_PHOTOS) rows of these; -1: none.
    const std::int32_t* members;
    /// (G, PHOTO_NUMBERS, GROUP_PHOTOS) the same numbers.
    const float* blocks;
    /// (G, GROUP_NUMBERS) sphere around the centres, planes around what the photos show.
    const float* bounds;
};

}  // namespace lfnav
