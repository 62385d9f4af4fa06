// Regions of the virtual image, each with some photos and weights that are bilinear in the pixel,
// and the pixels that are in them.

#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "homography.hpp"
#include "level.hpp"
#include "ranking.hpp"
#include "sampling.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Photos that are blended in a region: of a tile those of its four corners.
constexpr std::size_t MOST_BLENDED = 4 * SHARING;

/// A region's photos and the weights a x + b y + c + d x y of each. Places x, y count from a pixel
/// of the region, which is at (left, top) from the image's middle: weights may be steep.
struct Region {
    std::size_t count;
    std::int32_t photo[MOST_BLENDED];
    float a[MOST_BLENDED], b[MOST_BLENDED], c[MOST_BLENDED], d[MOST_BLENDED];
    float left, top;
};

/// Pixels, region by region; so many numbers behind the last one may be read and written, too.
struct RegionPixels {
    explicit RegionPixels(std::size_t count)
        : x(count + TOGETHER), y(count + TOGETHER), place(count + TOGETHER) {}

    /// Where each region's pixels begin, and the end of the last one's.
    std::vector<std::size_t> starts;
    /// Where they are, from the image's middle, and which they are in the order of the image.
    std::vector<float> x, y;
    std::vector<std::int32_t> place;
};

}  // namespace lfnav::LFNAV_LEVEL
