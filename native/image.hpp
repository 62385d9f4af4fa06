// Images as kernels take them: what Python's arrays hold, without owning it.

#pragma once

#include <cstddef>
#include <cstdint>

namespace lfnav {

/// An image (H, W, 4) of floats, row by row: colours or other channels, and as the fourth number of
/// a pixel 1 where there is one, and 0 where not.
struct MaskedImage {
    const float* data;
    std::size_t height, width;

    const float* row(std::size_t y) const { return data + 4 * width * y; }
};

/// One float a pixel (H, W), row by row.
struct ScalarImage {
    const float* data;
    std::size_t height, width;

    const float* row(std::size_t y) const { return data + width * y; }
};

/// Grey levels (H, W), row by row.
struct GreyImage {
    const std::uint8_t* data;
    std::size_t height, width;

    const std::uint8_t* row(std::size_t y) const { return data + width * y; }
};

}  // namespace lfnav
