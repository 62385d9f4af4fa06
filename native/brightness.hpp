// Gain and offset between a rendered view and a camera image, robustly.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "image.hpp"
#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

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

// Standard deviation of a normal distribution over its median absolute deviation.
constexpr double MAD_TO_SIGMA = 1.4826;
// Rounds of reweighting in which the brightness settles.
constexpr int ROUNDS = 3;
// Below one grey level of contrast there is no gain to be told.
constexpr double SMALLEST_VARIANCE = 1.0;
// A bin is an eighth of a grey level wide, or a quarter where both signs are counted.
constexpr std::size_t BINS = 2041;

/// Values of the channels of all pixels that are compared.
struct BrightnessSamples {
    std::unique_ptr<double[]> memory;
    std::unique_ptr<std::int32_t[]> bins;
    double *rendered, *wanted, *errors;
    std::size_t count = 0;

    BrightnessSamples(const MaskedImage& view, const MaskedImage& target, std::size_t stride) {
        const std::size_t rows = (view.height + stride - 1) / stride;
        const std::size_t columns = (view.width + stride - 1) / stride;
        const std::size_t most = 3 * (rows * columns + 1);
        memory = std::make_unique_for_overwrite<double[]>(3 * most);
        bins = std::make_unique_for_overwrite<std::int32_t[]>(most);
        rendered = memory.get();
        wanted = rendered + most;
        errors = wanted + most;
        for (std::size_t y = 0; y < view.height; y += stride) {
            for (std::size_t x = 0; x < view.width; x += stride) {
                const float *from = view.row(y) + 4 * x, *to = target.row(y) + 4 * x;
                for (std::size_t channel = 0; channel < 3; ++channel) {
                    rendered[count + channel] = from[channel];
                    wanted[count + channel] = to[channel];
                }
                // What is not compared the next pixel overwrites: cheaper than a branch.
                count += from[3] * to[3] > 0.0F ? 3 : 0;
            }
        }
    }
};

/// The median of the errors to within a bin, which is exact enough for a scale.
///
/// @param low: errors below this count as it, and
/// @param high: errors above this, and NaN, as that.
LFNAV_INLINE double binned_median(const BrightnessSamples& samples, double low, double high) {
    const double scale = static_cast<double>(BINS - 1) / (high - low);
    const double* const errors = samples.errors;
    std::int32_t* const bins = samples.bins.get();
#pragma omp simd
    for (std::size_t i = 0; i < samples.count; ++i) {
        const double from_above = errors[i] < high ? errors[i] : high;
        const double place = from_above > low ? from_above : low;
        bins[i] = static_cast<std::int32_t>((place - low) * scale + 0.5);
    }
    // Two, since a bin that was just counted up cannot be read again at once.
    std::array<std::uint32_t, BINS> even{}, odd{};
    std::size_t i = 0;
    for (; i + 1 < samples.count; i += 2) {
        ++even[static_cast<std::size_t>(bins[i])];
        ++odd[static_cast<std::size_t>(bins[i + 1])];
    }
    if (i < samples.count) {
        ++even[static_cast<std::size_t>(bins[i])];
    }
    const std::size_t half = (samples.count + 1) / 2;
    std::size_t seen = 0;
    for (std::size_t bin = 0; bin < BINS; ++bin) {
        seen += even[bin] + odd[bin];
        if (seen >= half) {
            return low + static_cast<double>(bin) / scale;
        }
    }
    return high;
}

/// Iteratively reweighted least squares with Tukey's biweight (Huber and Ronchetti 2009, "Robust
/// Statistics", chapter 7).
///
/// @param stride: only every so many-th pixel of every so many-th row is used.
inline Brightness fitted_brightness(const MaskedImage& view, const MaskedImage& target,
                                    std::size_t stride, const BrightnessLimits& limits) {
    const BrightnessSamples samples(view, target, stride);
    const std::size_t count = samples.count;
    if (count == 0) {
        return {1.0, 0.0, limits.smallest_scale};
    }
    const double *const rendered = samples.rendered, *const wanted = samples.wanted;
    double* const errors = samples.errors;
#pragma omp simd
    for (std::size_t i = 0; i < count; ++i) {
        errors[i] = wanted[i] - rendered[i];
    }
    Brightness found{1.0, binned_median(samples, -255.0, 255.0), limits.smallest_scale};
    for (int round = 0;; ++round) {
        const double gain = found.gain, offset = found.offset;
#pragma omp simd
        for (std::size_t i = 0; i < count; ++i) {
            errors[i] = std::abs(gain * rendered[i] + offset - wanted[i]);
        }
        const double median = binned_median(samples, 0.0, 255.0);
        found.scale = std::max(limits.smallest_scale, MAD_TO_SIGMA * median);
        if (round == ROUNDS) {
            return found;
        }
        // Sums of Tukey's weights, and of them times the values and their products.
        const double inverse_limit = 1.0 / (limits.cutoff * found.scale);
        double s = 0.0, r = 0.0, w = 0.0, rr = 0.0, rw = 0.0;
#pragma omp simd reduction(+ : s, r, w, rr, rw)
        for (std::size_t i = 0; i < count; ++i) {
            const double ratio = errors[i] * inverse_limit;
            const double rest = 1.0 - ratio * ratio;
            const double inside = rest > 0.0 ? rest : 0.0;
            const double weight = inside * inside;
            const double weighted = weight * rendered[i];
            s += weight;
            r += weighted;
            w += weight * wanted[i];
            rr += weighted * rendered[i];
            rw += weighted * wanted[i];
        }
        const double mean = r / s, wanted_mean = w / s, variance = rr / s - mean * mean;
        // Not a number either: where all weights are zero.
        if (!(variance >= SMALLEST_VARIANCE)) {
            return found;
        }
        const double slope = (rw / s - mean * wanted_mean) / variance;
        found.gain = std::clamp(slope, 1.0 / limits.largest_gain, limits.largest_gain);
        found.offset = wanted_mean - found.gain * mean;
    }
}

}  // namespace lfnav::LFNAV_LEVEL
