// What benchmarks/limit.py measures: samples of photos, weighted and added up.

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "sampling.hpp"

/// Writes P pixels of three samples each; the arrays are those of LimitWork.
///
/// @param image: (P, 4) receives the sums.
/// @param times: how often that is done.
extern "C" void add_samples(const std::uint8_t* texels, const std::int32_t* upper,
                            const std::int32_t* lower, const float* fraction,
                            const float* upper_weight, const float* lower_weight, float* image,
                            std::size_t pixels, std::size_t times) {
    using namespace lfnav::LFNAV_LEVEL;
    constexpr std::size_t SAMPLES = 3;
    for (std::size_t turn = 0; turn < times; ++turn) {
        for (std::size_t pixel = 0; pixel < pixels; ++pixel) {
            Texel sum = {};
            for (std::size_t i = SAMPLES * pixel; i < SAMPLES * (pixel + 1); ++i) {
                const TexelPair column =
                    two_texels(texels + 4 * static_cast<std::size_t>(upper[i])) * upper_weight[i] +
                    two_texels(texels + 4 * static_cast<std::size_t>(lower[i])) * lower_weight[i];
                const Texel left = __builtin_shufflevector(column, column, 0, 1, 2, 3);
                const Texel right = __builtin_shufflevector(column, column, 4, 5, 6, 7);
                sum = sum + left + (right - left) * fraction[i];
            }
            std::memcpy(image + 4 * pixel, &sum, sizeof sum);
        }
        // Each turn is done: for all the compiler knows somebody has read the image.
        asm volatile("" : : "r"(image) : "memory");
    }
}
