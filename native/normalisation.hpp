// From sums of weighted colours to colours.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "level.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Which numbers of pixels of four channels are of one channel.
template <std::size_t CHANNEL>
LFNAV_INLINE IntegerVector is_channel() {
    IntegerVector result = {};
    for (std::size_t i = CHANNEL; i < BYTES / sizeof(float); i += 4) {
        result[i] = -1;
    }
    return result;
}

/// Normalises as many pixels as a vector has numbers: one division for all of them.
///
/// @return 1 for each pixel that is shown.
LFNAV_INLINE FloatVector normalise_some(float* image, float smallest) {
    using Vector = FloatVector;
    constexpr std::size_t FLOATS = BYTES / sizeof(float);
    const Vector a = loaded<Vector>(image), b = loaded<Vector>(image + FLOATS);
    const Vector c = loaded<Vector>(image + 2 * FLOATS), d = loaded<Vector>(image + 3 * FLOATS);
    const Vector zero = {}, of_c_and_d = is_channel<2>() ? spread<3>(c) : spread<3>(d);
    const Vector total =
        is_channel<0>() ? spread<3>(a) : (is_channel<1>() ? spread<3>(b) : of_c_and_d);
    const auto is_shown = total > zero + smallest;
    const Vector factor = is_shown ? 255.0F / total : zero, alpha = is_shown ? zero + 1.0F : zero;
    const auto is_alpha = is_channel<3>();
    store(is_alpha ? spread<0>(alpha) : a * spread<0>(factor), image);
    store(is_alpha ? spread<1>(alpha) : b * spread<1>(factor), image + FLOATS);
    store(is_alpha ? spread<2>(alpha) : c * spread<2>(factor), image + 2 * FLOATS);
    store(is_alpha ? spread<3>(alpha) : d * spread<3>(factor), image + 3 * FLOATS);
    return alpha;
}

/// Divides colours by their weights; alpha becomes 1 or, where no photo shows anything, 0.
///
/// @param image: (P, 4) sums of weighted colours, and of 255 times the weights.
/// @param smallest: sum of weights below which a pixel is not shown.
/// @return how many pixels no photo shows.
LFNAV_INLINE std::size_t normalise(float* image, std::size_t pixels, float smallest) {
    constexpr std::size_t TAKEN = BYTES / sizeof(float);
    FloatVector shown = {};
    std::size_t first = 0;
    for (; first + TAKEN <= pixels; first += TAKEN) {
        shown += normalise_some(image + 4 * first, 255.0F * smallest);
    }
    if (first < pixels) {
        float rest[4 * TAKEN] = {};
        std::copy(image + 4 * first, image + 4 * pixels, rest);
        shown += normalise_some(rest, 255.0F * smallest);
        std::copy_n(rest, 4 * (pixels - first), image + 4 * first);
    }
    std::size_t count = 0;
    for (std::size_t i = 0; i < TAKEN; ++i) {
        count += static_cast<std::size_t>(shown[i]);
    }
    return pixels - count;
}

}  // namespace lfnav::LFNAV_LEVEL
