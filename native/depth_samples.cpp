#include "depth_samples.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace lfnav {

namespace {

constexpr std::size_t BATCH = DepthSamples::BATCH;
/// Rows of samples that are gone through column by column, so that batches are as wide as high.
constexpr std::size_t STRIP = 12;
/// How far apart neighbours are in a batch; odd, so that all places are taken.
constexpr std::size_t APART = 51;

/// Columns, or rows, that are sampled.
std::vector<std::size_t> sampled(std::int64_t length, double step) {
    std::vector<std::size_t> places;
    for (std::size_t i = 0; step * static_cast<double>(i) < static_cast<double>(length); ++i) {
        places.push_back(static_cast<std::size_t>(step * static_cast<double>(i)));
    }
    return places;
}

/// Writes batches one after the other.
class BatchWriter {
  public:
    BatchWriter(float* values, float* boxes, std::size_t length)
        : values_(values), boxes_(boxes), length_(length) {}

    /// Of all photos so far.
    std::size_t batches() const { return batches_; }

    void add(float x, float y, float inverse_depth) {
        last_ = {x, y, inverse_depth};
        for (std::size_t axis = 0; axis < 3; ++axis) {
            values_[axis * BATCH + filled_ * APART % BATCH] = last_[axis];
            low_[axis] = std::min(low_[axis], last_[axis]);
            high_[axis] = std::max(high_[axis], last_[axis]);
        }
        if (++filled_ == BATCH) {
            end_batch();
        }
    }

    /// Fills a batch that has been begun up with its last sample.
    void fill_up() {
        while (filled_ > 0) {
            add(last_[0], last_[1], last_[2]);
        }
    }

  private:
    void end_batch() {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            boxes_[axis * length_ + batches_] = 0.5F * (low_[axis] + high_[axis]);
            boxes_[(axis + 3) * length_ + batches_] = 0.5F * (high_[axis] - low_[axis]);
        }
        values_ += 3 * BATCH;
        ++batches_;
        filled_ = 0;
        low_ = {LARGEST, LARGEST, LARGEST};
        high_ = {-LARGEST, -LARGEST, -LARGEST};
    }

    static constexpr float LARGEST = std::numeric_limits<float>::infinity();
    float *values_, *boxes_;
    std::size_t length_, batches_ = 0, filled_ = 0;
    std::array<float, 3> last_{}, low_{LARGEST, LARGEST, LARGEST},
        high_{-LARGEST, -LARGEST, -LARGEST};
};

}  // namespace

DepthSamples::DepthSamples(const Photos& photos, std::span<const bool> is_source,
                           std::span<const double> steps)
    : starts(photos.count), ends(photos.count) {
    std::vector<std::vector<std::size_t>> columns(photos.count), rows(photos.count);
    std::size_t most = 0;
    for (std::size_t photo = 0; photo < photos.count; ++photo) {
        if (is_source[photo]) {
            columns[photo] = sampled(photos.depth_size[2 * photo], steps[photo]);
            rows[photo] = sampled(photos.depth_size[2 * photo + 1], steps[photo]);
            most += (columns[photo].size() * rows[photo].size() + BATCH - 1) / BATCH;
        }
    }
    length = most + BATCHES;
    values = std::make_unique_for_overwrite<float[]>(3 * BATCH * most);
    boxes.resize(6 * length);
    BatchWriter writer(values.get(), boxes.data(), length);
    for (std::size_t photo = 0; photo < photos.count; ++photo) {
        const auto width = static_cast<std::size_t>(photos.depth_size[2 * photo]);
        const auto height = static_cast<std::size_t>(photos.depth_size[2 * photo + 1]);
        const float* const map = photos.inverse_depth + photos.depth_start[photo];
        const double middle_x = 0.5 * static_cast<double>(width) - 0.5;
        const double middle_y = 0.5 * static_cast<double>(height) - 0.5;
        starts[photo] = writer.batches();
        for (std::size_t top = 0; top < rows[photo].size(); top += STRIP) {
            const std::size_t below = std::min(top + STRIP, rows[photo].size());
            for (const std::size_t column : columns[photo]) {
                const auto x = static_cast<float>(static_cast<double>(column) - middle_x);
                for (std::size_t i = top; i < below; ++i) {
                    const std::size_t row = rows[photo][i];
                    const float value = map[row * width + column];
                    if (value > 0.0F) {
                        writer.add(x, static_cast<float>(static_cast<double>(row) - middle_y),
                                   value);
                    }
                }
            }
        }
        writer.fill_up();
        ends[photo] = writer.batches();
    }
    count = BATCH * writer.batches();
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
