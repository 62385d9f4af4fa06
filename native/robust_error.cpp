#include "robust_error.hpp"

#include <algorithm>
#include <cstring>

#include "level.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

namespace {

/// Gain, offset and one over the limit, so that an error of 1 is at the limit.
struct ScaledPhotometry {
    float gain, offset, scale;
};

/// As many pixels of four channels as a register holds, and what is done with them.
struct Pixels {
    using Vector = FloatVector;
    static constexpr std::size_t FLOATS = BYTES / sizeof(float);

    /// What pixels cost, relative to the largest loss; in the fourth channel it means nothing.
    LFNAV_INLINE static Vector losses(Vector view, Vector target, const ScaledPhotometry& scaled) {
        const Vector compared = spread<3>(target), seen = compared * spread<3>(view);
        const Vector error = scaled.gain * view + scaled.offset - scaled.scale * target;
        const Vector rest = 1.0F - error * error, zero = {};
        const Vector inside = rest > zero ? rest : zero;
        return compared - seen * inside * inside * inside;
    }
};

/// Sum of the losses of a view, relative to the largest, over the number of pixels compared.
struct MeanLoss {
    const MaskedImage& view;
    const MaskedImage& target;
    ScaledPhotometry scaled;

    // Sums kept apart, since the next addition to one waits for the last.
    static constexpr std::size_t SUMS = 4;

    LFNAV_INLINE double operator()() const {
        using Some = Pixels;
        using Vector = Some::Vector;
        constexpr std::size_t FLOATS = Some::FLOATS;
        double sum = 0.0, count = 0.0;
        for (std::size_t y = 0; y < view.height; ++y) {
            const float *rendered = view.row(y), *wanted = target.row(y);
            Vector losses[SUMS] = {}, compared = {};
            const std::size_t end = 4 * view.width;
            std::size_t i = 0;
            for (; i + SUMS * FLOATS <= end; i += SUMS * FLOATS) {
                for (std::size_t k = 0; k < SUMS; ++k) {
                    const Vector a = loaded<Vector>(rendered + i + k * FLOATS);
                    const Vector b = loaded<Vector>(wanted + i + k * FLOATS);
                    losses[k] += Some::losses(a, b, scaled);
                    compared += b;
                }
            }
            for (; i + FLOATS <= end; i += FLOATS) {
                const Vector a = loaded<Vector>(rendered + i);
                const Vector b = loaded<Vector>(wanted + i);
                losses[0] += Some::losses(a, b, scaled);
                compared += b;
            }
            if (i < end) {
                const Vector a = loaded(rendered + i, end - i);
                const Vector b = loaded(wanted + i, end - i);
                losses[0] += Some::losses(a, b, scaled);
                compared += b;
            }
            const Vector total = (losses[0] + losses[1]) + (losses[2] + losses[3]);
            for (std::size_t pixel = 0; pixel < FLOATS; pixel += 4) {
                sum += static_cast<double>(total[pixel]) + static_cast<double>(total[pixel + 1]) +
                       static_cast<double>(total[pixel + 2]);
                count += static_cast<double>(compared[pixel + 3]);
            }
        }
        return sum / std::max(count, 1.0);
    }
};

}  // namespace

double robust_error(const MaskedImage& view, const MaskedImage& target,
                    const Photometry& photometry) {
    const double limit = photometry.limit;
    const ScaledPhotometry scaled{static_cast<float>(photometry.gain / limit),
                                  static_cast<float>(photometry.offset / limit),
                                  static_cast<float>(1.0 / limit)};
    // The largest loss of a channel, which all losses are relative to, is a sixth of this square.
    return MeanLoss{view, target, scaled}() / 3.0 * limit * limit / 6.0;
}

}  // namespace lfnav::LFNAV_LEVEL
