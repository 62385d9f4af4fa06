// How different a rendered view is from a camera image: the costs of
// pipelines/render/comparison.py, which says what they are and what their constants mean.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

#include "image.hpp"
#include "level.hpp"
#include "simd.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Numbers of pixels that are added up in single precision before the sum is kept in double.
constexpr std::size_t BLOCK = 256;

/// Of pixels of four channels the sum of the first three, and of the fourth.
struct ChannelSums {
    double colours = 0.0, fourth = 0.0;

    LFNAV_INLINE void add(const FloatVector& pixels) {
        for (std::size_t i = 0; i < sizeof pixels / sizeof(float); i += 4) {
            colours += static_cast<double>(pixels[i] + pixels[i + 1] + pixels[i + 2]);
            fourth += static_cast<double>(pixels[i + 3]);
        }
    }
};

/// Calls a function with vectors of the pixels of two images, and which of two sums they belong to:
/// the next addition to one waits for the last.
template <typename Function>
LFNAV_INLINE void for_pixels(const float* image, const float* query, std::size_t pixels,
                             Function function) {
    constexpr std::size_t FLOATS = BYTES / sizeof(float);
    const std::size_t end = 4 * pixels;
    std::size_t i = 0;
    for (; i + 2 * FLOATS <= end; i += 2 * FLOATS) {
        function(loaded<FloatVector>(image + i), loaded<FloatVector>(query + i), 0);
        function(loaded<FloatVector>(image + i + FLOATS), loaded<FloatVector>(query + i + FLOATS),
                 1);
    }
    for (; i < end; i += FLOATS) {
        function(loaded(image + i, end - i), loaded(query + i, end - i), 0);
    }
}

LFNAV_INLINE FloatVector absolute(const FloatVector& value) { return larger(value, -value); }

/// The factor that fits an image best, between one over the largest gain and the largest.
///
/// @param limit: colours that differ by more do not count: what stands in front of the scene must
///     not change the brightness of what is seen beside it.
LFNAV_INLINE double fitted_gain(const float* image, const float* query, std::size_t count,
                                float limit, double largest) {
    using Vector = FloatVector;
    ChannelSums product, square;
    for (std::size_t first = 0; first < count; first += BLOCK) {
        Vector products[2] = {}, squares[2] = {};
        const auto add = [&](const Vector& a, const Vector& b,
                             std::size_t sum) __attribute__((always_inline)) {
            const Vector zero = {}, used = spread<3>(a * b);
            const Vector weighted = absolute(a - b) < zero + limit ? used * a : zero;
            products[sum] += weighted * b;
            squares[sum] += weighted * a;
        };
        for_pixels(image + 4 * first, query + 4 * first, std::min(BLOCK, count - first), add);
        product.add(products[0] + products[1]);
        square.add(squares[0] + squares[1]);
    }
    return square.colours > 0.0
               ? std::clamp(product.colours / square.colours, 1.0 / largest, largest)
               : 1.0;
}

/// Mean squared or limited absolute difference, relative to the largest.
template <bool ROBUST>
LFNAV_INLINE double difference_cost(const float* image, const float* query, std::size_t count,
                                    float gain, const CostSettings& settings) {
    using Vector = FloatVector;
    const float limit = settings.robust_limit;
    ChannelSums differences, covered, compared;
    for (std::size_t first = 0; first < count; first += BLOCK) {
        Vector own[2] = {}, own_covered[2] = {}, own_compared[2] = {};
        const auto add = [&](const Vector& a, const Vector& b,
                             std::size_t sum) __attribute__((always_inline)) {
            const Vector zero = {}, both = a * b, error = gain * a - b;
            own_covered[sum] += both;
            own_compared[sum] += b;
            own[sum] +=
                spread<3>(both) * (ROBUST ? smaller(absolute(error), zero + limit) : error * error);
        };
        for_pixels(image + 4 * first, query + 4 * first, std::min(BLOCK, count - first), add);
        differences.add(own[0] + own[1]);
        covered.add(own_covered[0] + own_covered[1]);
        compared.add(own_compared[0] + own_compared[1]);
    }
    const double largest = ROBUST ? static_cast<double>(limit) : 255.0 * 255.0;
    const double uncovered = ROBUST ? settings.uncovered_robust : settings.uncovered_squared;
    const double total =
        differences.colours + 3.0 * largest * uncovered * (compared.fourth - covered.fourth);
    return total / (3.0 * largest * std::max(compared.fourth, 1.0));
}

/// (1 - zero-mean normalised cross-correlation) / 2 over all channels together.
LFNAV_INLINE double correlation_cost(const float* image, const float* query, std::size_t count,
                                     const CostSettings& settings) {
    double covered = 0.0, compared = 0.0, a1 = 0.0, b1 = 0.0, a2 = 0.0, b2 = 0.0, ab = 0.0;
#pragma omp simd reduction(+ : covered, compared, a1, b1, a2, b2, ab)
    for (std::size_t i = 0; i < count; ++i) {
        const auto used = static_cast<double>(image[4 * i + 3] * query[4 * i + 3]);
        covered += used;
        compared += static_cast<double>(query[4 * i + 3]);
        for (std::size_t channel = 0; channel < 3; ++channel) {
            const double a = used * static_cast<double>(image[4 * i + channel]);
            const double b = used * static_cast<double>(query[4 * i + channel]);
            a1 += a;
            b1 += b;
            a2 += a * a;
            b2 += b * b;
            ab += a * b;
        }
    }
    if (covered == 0.0) {
        return settings.uncovered_zncc;
    }
    const double share = covered / std::max(compared, 1.0), n = 3.0 * covered;
    const double variance_a = a2 - a1 * a1 / n, variance_b = b2 - b1 * b1 / n;
    double correlation = 0.0;
    // Below one grey level of contrast there is nothing to correlate.
    if (variance_a > n && variance_b > n) {
        correlation = (ab - a1 * b1 / n) / std::sqrt(variance_a * variance_b);
    }
    return share * (1.0 - correlation) / 2.0 + (1.0 - share) * settings.uncovered_zncc;
}

/// Mean limited difference of the gradients of whole images.
inline double gradient_cost(const MaskedImage& image, const MaskedImage& query, float gain,
                            const CostSettings& settings) {
    const auto limit = static_cast<double>(settings.gradient_limit);
    double total = 0.0;
    std::size_t count = 0;
    for (std::size_t y = 0; y < image.height; ++y) {
        for (std::size_t x = 0; x < image.width; ++x) {
            for (std::size_t step = 0; step < 2; ++step) {
                const std::size_t other_y = y + step, other_x = x + 1 - step;
                if (other_y >= image.height || other_x >= image.width) {
                    continue;
                }
                const float *a = image.row(y) + 4 * x, *b = query.row(y) + 4 * x;
                const float* next_a = image.row(other_y) + 4 * other_x;
                const float* next_b = query.row(other_y) + 4 * other_x;
                if (b[3] * next_b[3] == 0.0F) {
                    continue;
                }
                ++count;
                if (a[3] * next_a[3] == 0.0F) {
                    total += 3.0 * limit * settings.uncovered_gradient;
                    continue;
                }
                for (std::size_t channel = 0; channel < 3; ++channel) {
                    const float rendered = next_a[channel] - a[channel];
                    const float taken = next_b[channel] - b[channel];
                    const float size = std::abs(gain * rendered - taken);
                    total += static_cast<double>(std::min(size, settings.gradient_limit));
                }
            }
        }
    }
    return total / (3.0 * limit * static_cast<double>(std::max<std::size_t>(count, 1)));
}

/// Minus the sum of what pixels' differences say.
LFNAV_INLINE double evidence_cost(const float* image, const float* query, std::size_t count,
                                  const CostSettings& settings) {
    const float scale = 1.0F / settings.evidence_bin;
    const auto bins = static_cast<std::int32_t>(settings.evidence_bins);
    const auto last = static_cast<float>(bins - 1);
    const float* const table = settings.evidence.data();
    double total = 0.0;
    std::int32_t entries[BLOCK];
    for (std::size_t first = 0; first < count; first += BLOCK) {
        const float *a = image + 4 * first, *b = query + 4 * first;
        const std::size_t pixels = std::min(BLOCK, count - first);
#pragma omp simd
        for (std::size_t i = 0; i < pixels; ++i) {
            const float difference = std::abs(a[4 * i] - b[4 * i]) +
                                     std::abs(a[4 * i + 1] - b[4 * i + 1]) +
                                     std::abs(a[4 * i + 2] - b[4 * i + 2]);
            const float bin = difference * scale;
            // What is not covered or not compared looks up the row of zeros.
            const auto row = static_cast<std::int32_t>(a[4 * i + 3] * b[4 * i + 3]);
            entries[i] = row * bins + static_cast<std::int32_t>(bin < last ? bin : last);
        }
        double sums[4] = {};
        for (std::size_t i = 0; i < pixels; ++i) {
            sums[i % 4] += static_cast<double>(table[static_cast<std::size_t>(entries[i])]);
        }
        total -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
    }
    return total;
}

/// The cost of one rendered view; smaller is better.
///
/// @param image: rendered, 0 to 255, and 1 where covered, else 0.
LFNAV_INLINE double compare(const MaskedImage& image, const Comparison& comparison) {
    const auto& [cost, query, fit_gain, settings] = comparison;
    const std::size_t count = image.width * image.height;
    const float *a = image.data, *b = query.data;
    if (cost == Cost::EVIDENCE) {
        return evidence_cost(a, b, count, settings);
    }
    if (cost == Cost::ZNCC) {
        return correlation_cost(a, b, count, settings);
    }
    float gain = 1.0F;
    if (fit_gain) {
        const float limit = cost == Cost::ROBUST ? settings.robust_limit : INFINITY;
        gain = static_cast<float>(fitted_gain(a, b, count, limit, settings.largest_gain));
    }
    if (cost == Cost::GRADIENT) {
        return gradient_cost(image, query, gain, settings);
    }
    if (cost == Cost::ROBUST) {
        return difference_cost<true>(a, b, count, gain, settings);
    }
    return difference_cost<false>(a, b, count, gain, settings);
}

}  // namespace lfnav::LFNAV_LEVEL
