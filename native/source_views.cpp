#include "source_views.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace lfnav {

void choose_sources(const Photos& photos, const double* pose, double usual_inverse_depth,
                    double turn_cost, std::span<std::int32_t> sources) {
    std::vector<std::pair<double, std::int32_t>> best;
    for (std::size_t photo = 0; photo < photos.count; ++photo) {
        // The third row of a projection is the optical axis.
        const double* const axis = photos.projection + 12 * photo + 8;
        double squared = 0.0, cosine = 0.0;
        for (std::size_t i = 0; i < 3; ++i) {
            const double offset = photos.centres[3 * photo + i] - pose[4 * i + 3];
            squared += offset * offset;
            cosine += axis[i] * pose[4 * i + 2];
        }
        const double turn = std::sqrt(2.0 - 2.0 * std::clamp(cosine, -1.0, 1.0));
        const double cost = std::sqrt(squared) * usual_inverse_depth + turn_cost * turn;
        const bool is_better = best.size() < sources.size() || cost < best.back().first;
        if (photos.depth_size[2 * photo] == 0 || !is_better) {
            continue;
        }
        if (best.size() == sources.size()) {
            best.pop_back();
        }
        const auto after = std::find_if(best.begin(), best.end(),
                                        [&](const auto& one) { return one.first > cost; });
        best.insert(after, {cost, static_cast<std::int32_t>(photo)});
    }
    std::fill(sources.begin(), sources.end(), -1);
    std::transform(best.begin(), best.end(), sources.begin(),
                   [](const auto& one) { return one.second; });
}

}  // namespace lfnav
