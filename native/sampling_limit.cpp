#include "sampling_limit.hpp"

#include <cstring>

#include "level.hpp"
#include "sampling.hpp"

namespace lfnav::LFNAV_LEVEL {

void add_given_samples(const GivenSamples& samples, std::size_t times, float* image) {
    for (std::size_t turn = 0; turn < times; ++turn) {
        for (std::size_t pixel = 0; pixel < samples.pixels; ++pixel) {
            Texel total = {};
            for (std::size_t i = GivenSamples::EACH * pixel; i < GivenSamples::EACH * (pixel + 1);
                 ++i) {
                const auto upper = static_cast<std::size_t>(samples.upper[i]);
                const auto lower = static_cast<std::size_t>(samples.lower[i]);
                total =
                    total +
                    between(two_texels(samples.texels + 4 * upper) * samples.upper_weight[i] +
                                two_texels(samples.texels + 4 * lower) * samples.lower_weight[i],
                            samples.fraction[i]);
            }
            std::memcpy(image + 4 * pixel, &total, sizeof total);
        }
    }
}

}  // namespace lfnav::LFNAV_LEVEL
