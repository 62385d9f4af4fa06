// Depth that is smooth except across edges of the image: semi-global matching (Hirschmueller 2008).

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "image.hpp"
#include "level.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// What it costs that neighbouring pixels lie on different planes.
struct DepthPenalties {
    /// One plane apart; further apart; grey levels between the pixels at which a jump costs half.
    float step, jump, edge_contrast;
    /// A jump costs at least this.
    float least_jump;
};

constexpr std::size_t FLOATS = BYTES / sizeof(float), PATHS = 4;
// Higher than any path: what stands before the first plane and behind the last.
constexpr float WALL = 1e9F;

struct alignas(BYTES) FloatLanes {
    float values[FLOATS];
};

/// Costs of all planes at each pixel of a row, walls between them.
class PathRow {
  public:
    PathRow(std::size_t width, std::size_t planes)
        : stride_((planes + FLOATS - 1) / FLOATS + 1), lanes_(width * stride_ + 1) {
        fill(WALL);
    }

    void fill(float value) {
        std::fill(lanes_[0].values, lanes_[0].values + FLOATS * lanes_.size(), value);
    }

    float* at(std::size_t x) { return lanes_[x * stride_ + 1].values; }
    /// Floats of a pixel that are worked on: those of planes, and walls up to a full register.
    std::size_t length() const { return FLOATS * (stride_ - 1); }

  private:
    std::size_t stride_;
    std::vector<FloatLanes> lanes_;
};

/// Where a path comes from: the costs so far, the smallest of them, and what a jump costs here.
struct Step {
    const float* before;
    float smallest, jump;
    float* after;
};

/// Goes one step along four paths into a pixel.
///
/// @param costs: of the pixel, walls behind them.
/// @param sums: the sums over the paths are added to them.
/// @param least: (PATHS,) receives each path's smallest cost.
/// @return the smallest sum.
LFNAV_INLINE float advance(const float* costs, const Step (&from)[PATHS], float small,
                           std::size_t length, float* sums, float* least) {
    // In registers: what is stored below could not change them.
    const Step steps[PATHS] = {from[0], from[1], from[2], from[3]};
    FloatVector smallest[PATHS], lowest = FloatVector{} + 8.0F * WALL;
    std::fill_n(smallest, PATHS, lowest);
    for (std::size_t i = 0; i < length; i += FLOATS) {
        const auto cost = loaded<FloatVector>(costs + i);
        FloatVector sum = {};
#pragma GCC unroll 4
        for (std::size_t path = 0; path < PATHS; ++path) {
            const float* const before = steps[path].before + i;
            const FloatVector nearby =
                smaller(loaded<FloatVector>(before - 1), loaded<FloatVector>(before + 1)) + small;
            const FloatVector jump = FloatVector{} + (steps[path].smallest + steps[path].jump);
            const FloatVector way = smaller(smaller(loaded<FloatVector>(before), jump), nearby);
            const FloatVector value = cost + way - steps[path].smallest;
            store(value, steps[path].after + i);
            smallest[path] = smaller(smallest[path], value);
            sum = sum + value;
        }
        const FloatVector total = loaded<FloatVector>(sums + i) + sum;
        store(total, sums + i);
        lowest = smaller(lowest, total);
    }
    const auto minimum = [](const FloatVector& vector) {
        float result = vector[0];
        for (std::size_t i = 1; i < FLOATS; ++i) {
            result = std::min(result, static_cast<float>(vector[i]));
        }
        return result;
    };
    for (std::size_t path = 0; path < PATHS; ++path) {
        least[path] = minimum(smallest[path]);
    }
    return minimum(lowest);
}

/// Place of the smallest value, with a fraction from its neighbours.
inline float place_of(float lowest, const float* values, std::size_t count) {
    const auto best = static_cast<std::size_t>(std::find(values, values + count, lowest) - values);
    const auto place = static_cast<float>(best);
    if (best == 0 || best + 1 >= count) {
        return place;
    }
    const float before = values[best - 1] - lowest, after = values[best + 1] - lowest;
    if (before <= 0.0F && after <= 0.0F) {
        return place;
    }
    // Sums of absolute differences rise linearly on both sides: two lines of equal slope, no
    // parabola, which would be drawn towards the planes.
    return place + 0.5F * (before - after) / std::max(before, after);
}

/// Four paths into each pixel: from its side, and from three pixels of the row before.
class Matching {
  public:
    Matching(const std::uint8_t* volume, std::size_t planes, const GreyImage& reference,
             const DepthPenalties& penalties)
        : volume_(volume),
          planes_(planes),
          image_(reference),
          penalties_(penalties),
          start_(1, planes),
          costs_(1, planes) {
        start_.fill(0.0F);
        for (std::size_t i = 0; i < 2; ++i) {
            for (std::size_t path = 0; path < PATHS; ++path) {
                paths_[i].emplace_back(reference.width, planes);
                least_[i].emplace_back(reference.width);
            }
        }
        const std::size_t pixels = reference.height * reference.width;
        sums_ = std::make_unique<FloatLanes[]>(pixels * costs_.length() / FLOATS);
    }

    /// From the top left and, if it is the last, from the bottom right.
    void pass(bool is_last, float* index, float* distinctness) {
        const std::size_t height = image_.height, width = image_.width;
        for (std::size_t i = 0; i < height; ++i) {
            const std::size_t y = is_last ? height - 1 - i : i;
            for (std::size_t j = 0; j < width; ++j) {
                const std::size_t x = is_last ? width - 1 - j : j, pixel = y * width + x;
                const float total = load_costs(pixel);
                Step steps[PATHS];
                for (std::size_t path = 0; path < PATHS; ++path) {
                    steps[path] = step(is_last ? -1 : 1, x, y, path, i % 2);
                }
                float least[PATHS];
                float* const sums = sums_[pixel * costs_.length() / FLOATS].values;
                const float lowest =
                    advance(costs_.at(0), steps, penalties_.step, costs_.length(), sums, least);
                for (std::size_t path = 0; path < PATHS; ++path) {
                    least_[i % 2][path][x] = least[path];
                }
                if (is_last) {
                    index[pixel] = place_of(lowest, sums, planes_);
                    const auto plane = static_cast<std::size_t>(index[pixel] + 0.5F);
                    const float share = 1.0F / static_cast<float>(planes_);
                    distinctness[pixel] = total * share - costs_.at(0)[plane];
                }
            }
        }
    }

  private:
    /// Returns the sum of the costs.
    float load_costs(std::size_t pixel) {
        const std::uint8_t* const from = volume_ + pixel * planes_;
        float* const costs = costs_.at(0);
        std::int32_t total = 0;
#pragma omp simd reduction(+ : total)
        for (std::size_t d = 0; d < planes_; ++d) {
            const auto cost = static_cast<std::int32_t>(from[d]);
            costs[d] = static_cast<float>(cost);
            total += cost;
        }
        return static_cast<float>(total);
    }

    /// @param forward: 1, or -1 from the bottom right.
    LFNAV_INLINE Step step(std::ptrdiff_t forward, std::size_t x, std::size_t y, std::size_t path,
                           std::size_t current) {
        const auto signed_x = static_cast<std::ptrdiff_t>(x);
        const auto signed_y = static_cast<std::ptrdiff_t>(y);
        const std::ptrdiff_t from_x =
            path == 0 ? signed_x - forward : signed_x + static_cast<std::ptrdiff_t>(path) - 2;
        const std::ptrdiff_t from_y = path == 0 ? signed_y : signed_y - forward;
        float* const after = paths_[current][path].at(x);
        const auto width = static_cast<std::ptrdiff_t>(image_.width);
        if (from_x < 0 || from_x >= width || from_y < 0 ||
            from_y >= static_cast<std::ptrdiff_t>(image_.height)) {
            // A path that begins here: nothing so far, and a jump that is not taken.
            return {start_.at(0), 0.0F, 0.0F, after};
        }
        const std::size_t from = path == 0 ? current : 1 - current;
        const auto column = static_cast<std::size_t>(from_x);
        const int contrast = std::abs(static_cast<int>(image_.data[signed_y * width + signed_x]) -
                                      static_cast<int>(image_.data[from_y * width + from_x]));
        const float jump =
            penalties_.jump / (1.0F + static_cast<float>(contrast) / penalties_.edge_contrast);
        return {paths_[from][path].at(column), least_[from][path][column],
                std::max(jump, penalties_.least_jump), after};
    }

    const std::uint8_t* volume_;
    std::size_t planes_;
    GreyImage image_;
    DepthPenalties penalties_;
    /// What paths begin with, zeros; the costs of the current pixel.
    PathRow start_, costs_;
    /// Of this row and the one before, the paths and their smallest costs.
    std::vector<PathRow> paths_[2];
    std::vector<std::vector<float>> least_[2];
    std::unique_ptr<FloatLanes[]> sums_;
};

/// Finds the plane of each pixel along eight paths, winner takes all.
///
/// @param volume: (H, W, D) costs, D at least 1.
/// @param index: (H, W) receives the plane's number, with a fraction.
/// @param distinctness: (H, W) receives how much less it costs than the average plane.
inline void semi_global_matching(const std::uint8_t* volume, std::size_t planes,
                                 const GreyImage& reference, const DepthPenalties& penalties,
                                 float* index, float* distinctness) {
    Matching matching(volume, planes, reference, penalties);
    matching.pass(false, index, distinctness);
    matching.pass(true, index, distinctness);
}

}  // namespace lfnav::LFNAV_LEVEL
