// What nobody who blends three photos can do without: reading and weighting their texels. Rendering
// is measured against it (benchmarks/limit.py).

#pragma once

#include <cstddef>
#include <cstdint>

#include "instruction_set.hpp"

namespace lfnav {

/// Where and how photos are read, sample by sample; those of a pixel follow each other.
struct GivenSamples {
    static constexpr std::size_t EACH = 3;
    /// (T, 4).
    const std::uint8_t* texels;
    /// (3 P,) indices of the upper and of the lower left texel.
    const std::int32_t *upper, *lower;
    /// (3 P,) how far to the right of these, and the weights of upper and lower texels.
    const float *fraction, *upper_weight, *lower_weight;
    std::size_t pixels;
};

/// Adds up the samples of each pixel, so many times over.
///
/// @param image: (P, 4) receives the sums.
LFNAV_DECLARE(void add_given_samples(const GivenSamples& samples, std::size_t times, float* image))

}  // namespace lfnav
