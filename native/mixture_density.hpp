// The density of a mixture of normal distributions.

#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

/// N isotropic normal distributions of positions and angles.
struct Mixture {
    std::size_t count, dimensions;
    /// (N, P) centres, and (N,) logarithms of weights; -infinity is a weight of 0.
    const double *centres, *log_weights;
    double position_sigma, angle_sigma;
};

constexpr double NOTHING = -std::numeric_limits<double>::infinity();
// Terms that are smaller than the largest by this factor, as a logarithm, are lost in rounding.
constexpr double NEGLIGIBLE = -40.0;
// Distributions that are looked at together: most are far away, and need no exponential.
constexpr std::size_t TOGETHER = 32;

/// The exponential of a number from NEGLIGIBLE to 0, to a unit or two in the last place.
LFNAV_INLINE double exponential(double x) {
    // Added to a number it leaves the nearest integer in the lowest bits.
    constexpr double ROUNDING = 6755399441055744.0;
    constexpr double LOG2_E = 1.4426950408889634, LN2 = 0.6931471805599453,
                     LN2_REST = 2.3190468138462996e-17;
    const double shifted = x * LOG2_E + ROUNDING, whole = shifted - ROUNDING;
    const double r = (x - whole * LN2) - whole * LN2_REST;
    // Taylor's series; |r| is below 0.35.
    double sum = 1.0 / 479001600.0;
    for (const double factor :
         {1.0 / 39916800.0, 1.0 / 3628800.0, 1.0 / 362880.0, 1.0 / 40320.0, 1.0 / 5040.0,
          1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0}) {
        sum = sum * r + factor;
    }
    const std::uint64_t exponent = std::bit_cast<std::uint64_t>(shifted) + 1023U;
    return sum * std::bit_cast<double>(exponent << 52U);
}

/// Logarithms of the densities at places, but for the distributions' common factor.
///
/// @param places: how many, M.
/// @param positions: (M, P).
/// @param angles: (M, N) between the orientations there and those of the distributions, radians.
/// @param result: (M,) receives the logarithms; -infinity where all weights are 0.
inline void log_mixture_density(const Mixture& mixture, std::size_t places, const double* positions,
                                const double* angles, double* result) {
    const std::size_t count = mixture.count, dimensions = mixture.dimensions;
    const double position_scale = 0.5 / (mixture.position_sigma * mixture.position_sigma);
    const double angle_scale = 0.5 / (mixture.angle_sigma * mixture.angle_sigma);
    std::vector<double> centres(dimensions * count), exponents(count);
    for (std::size_t i = 0; i < dimensions; ++i) {
        for (std::size_t j = 0; j < count; ++j) {
            centres[i * count + j] = mixture.centres[j * dimensions + i];
        }
    }
    std::vector<double> largest_of((count + TOGETHER - 1) / TOGETHER);
    for (std::size_t place = 0; place < places; ++place) {
        const double* const angle = angles + place * count;
        double* const exponent = exponents.data();
        std::fill(exponents.begin(), exponents.end(), 0.0);
        for (std::size_t i = 0; i < dimensions; ++i) {
            const double position = positions[place * dimensions + i];
            const double* const centre = centres.data() + i * count;
#pragma omp simd
            for (std::size_t j = 0; j < count; ++j) {
                const double offset = position - centre[j];
                exponent[j] += offset * offset;
            }
        }
        double largest = NOTHING;
        for (std::size_t first = 0; first < count; first += TOGETHER) {
            double own = NOTHING;
            const std::size_t end = std::min(first + TOGETHER, count);
#pragma omp simd reduction(max : own)
            for (std::size_t j = first; j < end; ++j) {
                const double value = mixture.log_weights[j] - position_scale * exponent[j] -
                                     angle_scale * (angle[j] * angle[j]);
                exponent[j] = value;
                // Not a number is left out.
                own = value > own ? value : own;
            }
            largest_of[first / TOGETHER] = own;
            largest = std::max(largest, own);
        }
        double total = 0.0;
        for (std::size_t first = 0; first < count; first += TOGETHER) {
            if (!(largest_of[first / TOGETHER] - largest > NEGLIGIBLE)) {
                continue;
            }
            const std::size_t end = std::min(first + TOGETHER, count);
#pragma omp simd reduction(+ : total)
            for (std::size_t j = first; j < end; ++j) {
                const double x = exponent[j] - largest;
                const bool counts = x > NEGLIGIBLE;
                const double term = exponential(counts ? x : 0.0);
                total += counts ? term : 0.0;
            }
        }
        result[place] = largest == NOTHING ? NOTHING : largest + std::log(total);
    }
}

}  // namespace lfnav::LFNAV_LEVEL
