#include "depth_samples.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace lfnav {

namespace {

constexpr std::size_t BATCH = DepthSamples::BATCH;
/// Rows of samples that are gone through column by column, so that batches are as wide as high.
constexpr std::size_t STRIP = 12;
/// How far apart neighbours are in a batch; odd, so that all places are taken.
constexpr std::size_t APART = 51;

/// Where the column of a sample is among the values.
std::size_t place_of(std::size_t number) {
    return number / BATCH * (3 * BATCH) + number * APART % BATCH;
}

/// Columns, or rows, that are sampled.
std::vector<std::size_t> sampled(std::int64_t length, double step) {
    std::vector<std::size_t> places;
    for (std::size_t i = 0; step * static_cast<double>(i) < static_cast<double>(length); ++i) {
        places.push_back(static_cast<std::size_t>(step * static_cast<double>(i)));
    }
    return places;
}

}  // namespace

DepthSamples::DepthSamples(const Photos& photos, std::span<const bool> is_source,
                           std::span<const double> steps)
    : starts(photos.count), ends(photos.count) {
    std::size_t found = 0;
    const auto add = [&](float x, float y, float inverse_depth) {
        const std::size_t place = place_of(found);
        if (found % BATCH == 0) {
            values.resize(values.size() + 3 * BATCH);
        }
        values[place] = x;
        values[place + BATCH] = y;
        values[place + 2 * BATCH] = inverse_depth;
        ++found;
    };
    for (std::size_t photo = 0; photo < photos.count; ++photo) {
        starts[photo] = found / BATCH;
        const std::int64_t* const size = photos.depth_size + 2 * photo;
        if (is_source[photo]) {
            const auto columns = sampled(size[0], steps[photo]);
            const auto rows = sampled(size[1], steps[photo]);
            const float* const map = photos.inverse_depth + photos.depth_start[photo];
            const double middle_x = 0.5 * static_cast<double>(size[0]) - 0.5;
            const double middle_y = 0.5 * static_cast<double>(size[1]) - 0.5;
            for (std::size_t top = 0; top < rows.size(); top += STRIP) {
                for (const std::size_t column : columns) {
                    for (std::size_t i = top; i < std::min(top + STRIP, rows.size()); ++i) {
                        const float value =
                            map[rows[i] * static_cast<std::size_t>(size[0]) + column];
                        if (value > 0.0F) {
                            add(static_cast<float>(static_cast<double>(column) - middle_x),
                                static_cast<float>(static_cast<double>(rows[i]) - middle_y), value);
                        }
                    }
                }
            }
        }
        while (found % BATCH > 0) {
            const std::size_t last = place_of(found - 1);
            add(values[last], values[last + BATCH], values[last + 2 * BATCH]);
        }
        ends[photo] = found / BATCH;
    }
    const std::size_t length = found / BATCH + BATCHES;
    boxes.resize(6 * length);
    for (std::size_t batch = 0; batch < found / BATCH; ++batch) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const auto first =
                values.begin() + static_cast<std::ptrdiff_t>((3 * batch + axis) * BATCH);
            const auto [low, high] =
                std::minmax_element(first, first + static_cast<std::ptrdiff_t>(BATCH));
            boxes[axis * length + batch] = 0.5F * (*low + *high);
            boxes[(axis + 3) * length + batch] = 0.5F * (*high - *low);
        }
    }
}

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
