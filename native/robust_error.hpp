// The robust error of a rendered view against a camera image.

#pragma once

#include <algorithm>
#include <cstddef>

#include "image.hpp"
#include "level.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Brightness of a rendered view against a camera image, and what counts as an outlier.
struct Photometry {
    /// Factor on the rendered view, and what is added to it, grey levels.
    double gain, offset;
    /// Error beyond which a pixel counts as something else, grey levels.
    double limit;
};

/// Mean of Tukey's loss over all pixels, squared grey levels; an uncovered one costs the most.
///
/// @param view: rendered, and 1 where covered.
/// @param target: camera image, and 1 where it is to be compared.
inline double robust_error(const MaskedImage& view, const MaskedImage& target,
                           const Photometry& photometry) {
    using Vector = FloatVector;
    // Sums kept apart, since the next addition to one waits for the last.
    constexpr std::size_t FLOATS = BYTES / sizeof(float), SUMS = 4;
    // An error of 1 is at the limit.
    const double limit = photometry.limit;
    const auto gain = static_cast<float>(photometry.gain / limit);
    const auto offset = static_cast<float>(photometry.offset / limit);
    const auto scale = static_cast<float>(1.0 / limit);
    double sum = 0.0, count = 0.0;
    for (std::size_t y = 0; y < view.height; ++y) {
        const float *rendered = view.row(y), *wanted = target.row(y);
        Vector losses[SUMS] = {}, compared = {};
        // Relative to the largest loss; in the fourth channel they mean nothing.
        const auto add = [&](const Vector& a, const Vector& b,
                             std::size_t place) __attribute__((always_inline)) {
            const Vector used = spread<3>(b), seen = used * spread<3>(a);
            const Vector error = gain * a + offset - scale * b;
            const Vector rest = 1.0F - error * error, inside = rest > 0.0F ? rest : Vector{};
            losses[place] += used - seen * inside * inside * inside;
            compared += b;
        };
        const std::size_t end = 4 * view.width;
        std::size_t i = 0;
        for (; i + SUMS * FLOATS <= end; i += SUMS * FLOATS) {
            for (std::size_t k = 0; k < SUMS; ++k) {
                add(loaded<Vector>(rendered + i + k * FLOATS),
                    loaded<Vector>(wanted + i + k * FLOATS), k);
            }
        }
        for (; i < end; i += FLOATS) {
            add(loaded(rendered + i, end - i), loaded(wanted + i, end - i), 0);
        }
        const Vector total = (losses[0] + losses[1]) + (losses[2] + losses[3]);
        for (std::size_t pixel = 0; pixel < FLOATS; pixel += 4) {
            sum += static_cast<double>(total[pixel]) + static_cast<double>(total[pixel + 1]) +
                   static_cast<double>(total[pixel + 2]);
            count += static_cast<double>(compared[pixel + 3]);
        }
    }
    // The largest loss of a channel, which all losses are relative to, is a sixth of this square.
    return sum / std::max(count, 1.0) / 3.0 * limit * limit / 6.0;
}

}  // namespace lfnav::LFNAV_LEVEL
