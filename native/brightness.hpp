// Gain and offset between a rendered view and a camera image, robustly.

#pragma once

#include <cstddef>

#include "image.hpp"
#include "instruction_set.hpp"

namespace lfnav {

struct Brightness {
    double gain, offset;
    /// Standard deviation of what remains, estimated robustly.
    double scale;
};

/// Limits of a fit, in grey levels but for the gain.
struct BrightnessLimits {
    /// Errors beyond so many standard deviations count as something else.
    double cutoff;
    /// The standard deviation of the errors is taken for at least this.
    double smallest_scale;
    /// The gain stays between this and its inverse.
    double largest_gain;
};

/// Iteratively reweighted least squares with Tukey's biweight (Huber and Ronchetti 2009, "Robust
/// Statistics", chapter 7).
///
/// @param stride: only every so many-th pixel of every so many-th row is used.
LFNAV_DECLARE(Brightness fitted_brightness(const MaskedImage& view, const MaskedImage& target,
                                           std::size_t stride, const BrightnessLimits& limits))

}  // namespace lfnav
