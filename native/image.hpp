// Images as kernels take them: what Python's arrays hold, without owning it.

#pragma once

#include <cstddef>
#include <cstdint>

namespace lfnav {

/// An image (H, W) or (H, W, CHANNELS), row by row.
template <typename Element, std::size_t CHANNELS = 1>
struct Image {
    const Element* data;
    std::size_t height, width;

    const Element* row(std::size_t y) const { return data + CHANNELS * width * y; }
};

/// Colours or other channels, and as the fourth number of a pixel 1 where there is one, else 0.
using MaskedImage = Image<float, 4>;
using ScalarImage = Image<float>;
/// Grey levels.
using GreyImage = Image<std::uint8_t>;

}  // namespace lfnav
