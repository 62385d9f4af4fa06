#include "depth_completion.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

namespace {

// A surface is fitted to the known pixels so near to its rim ...
constexpr std::ptrdiff_t FIT_RADIUS = 12;
// ... whose inverse depth differs from the rim's by no more than this share,
constexpr double FIT_TOLERANCE = 0.06;
// and is taken to be level where fewer pixels than this remain.
constexpr int FIT_PIXELS = 40;
// Pulls slopes towards level, as if so many pixels a unit away said so.
constexpr double FIT_DAMPING = 50.0;
// A surface is not carried on beyond this share of the inverse depth at its rim, and its inverse.
constexpr double SMALLEST_CHANGE = 0.5;

/// How a surface rises along rows and columns, inverse depth a pixel.
struct Slopes {
    double down = 0.0, right = 0.0;
    bool is_known = false;
};

/// What a surface in some direction says, and how much that counts.
struct Opinion {
    double value, weight;
};

/// The value that half of the weight is on each side of.
double weighted_median(std::span<Opinion> opinions) {
    double half = 0.0;
    for (const Opinion& opinion : opinions) {
        half += 0.5 * opinion.weight;
    }
    std::sort(opinions.begin(), opinions.end(),
              [](const Opinion& a, const Opinion& b) { return a.value < b.value; });
    double total = 0.0;
    for (const Opinion& opinion : opinions) {
        total += opinion.weight;
        if (total >= half) {
            return opinion.value;
        }
    }
    return opinions.back().value;
}

class Completion {
  public:
    Completion(const ScalarImage& inverse_depth, const bool* known)
        : image_(inverse_depth),
          known_(known),
          height_(static_cast<std::ptrdiff_t>(inverse_depth.height)),
          width_(static_cast<std::ptrdiff_t>(inverse_depth.width)),
          slopes_(inverse_depth.height * inverse_depth.width) {}

    float at(std::ptrdiff_t y, std::ptrdiff_t x) {
        opinions_.clear();
        for (std::ptrdiff_t down = -1; down <= 1; ++down) {
            for (std::ptrdiff_t right = -1; right <= 1; ++right) {
                std::ptrdiff_t row = y + down, column = x + right, steps = 1;
                if (down == 0 && right == 0) {
                    continue;
                }
                while (is_inside(row, column) && !known_[row * width_ + column]) {
                    row += down;
                    column += right;
                    ++steps;
                }
                if (!is_inside(row, column)) {
                    continue;
                }
                const Slopes& slopes = slopes_at(row, column);
                const auto start = static_cast<double>(image_.data[row * width_ + column]);
                const double value = start + slopes.down * static_cast<double>(y - row) +
                                     slopes.right * static_cast<double>(x - column);
                const double length = std::sqrt(static_cast<double>(down * down + right * right));
                // Not a number stays none, and is no place in an order.
                const double bounded =
                    std::min(std::max(value, start * SMALLEST_CHANGE), start / SMALLEST_CHANGE);
                if (bounded == bounded) {
                    opinions_.push_back({bounded, 1.0 / (static_cast<double>(steps) * length)});
                }
            }
        }
        return opinions_.empty() ? image_.data[y * width_ + x]
                                 : static_cast<float>(weighted_median(opinions_));
    }

  private:
    bool is_inside(std::ptrdiff_t row, std::ptrdiff_t column) const {
        return row >= 0 && row < height_ && column >= 0 && column < width_;
    }

    /// Many pixels ask for the same place on the rim; it is fitted once.
    const Slopes& slopes_at(std::ptrdiff_t row, std::ptrdiff_t column) {
        Slopes& slopes = slopes_[static_cast<std::size_t>(row * width_ + column)];
        if (!slopes.is_known) {
            slopes = fitted(row, column);
        }
        return slopes;
    }

    Slopes fitted(std::ptrdiff_t row, std::ptrdiff_t column) const {
        const float middle = image_.data[row * width_ + column];
        const double tolerance = FIT_TOLERANCE * static_cast<double>(middle);
        double rr = FIT_DAMPING, rc = 0.0, cc = FIT_DAMPING, rq = 0.0, cq = 0.0;
        int count = 0;
        const std::ptrdiff_t bottom = std::min(row + FIT_RADIUS + 1, height_);
        const std::ptrdiff_t end = std::min(column + FIT_RADIUS + 1, width_);
        for (std::ptrdiff_t y = std::max(row - FIT_RADIUS, std::ptrdiff_t{0}); y < bottom; ++y) {
            const auto down = static_cast<double>(y - row);
            for (std::ptrdiff_t x = std::max(column - FIT_RADIUS, std::ptrdiff_t{0}); x < end;
                 ++x) {
                const auto rise = static_cast<double>(image_.data[y * width_ + x] - middle);
                if (!known_[y * width_ + x] || !(std::abs(rise) <= tolerance)) {
                    continue;
                }
                const auto right = static_cast<double>(x - column);
                rr += down * down;
                rc += down * right;
                cc += right * right;
                rq += down * rise;
                cq += right * rise;
                ++count;
            }
        }
        const double determinant = rr * cc - rc * rc;
        if (count < FIT_PIXELS || !(determinant > 0.0)) {
            return {0.0, 0.0, true};
        }
        return {(cc * rq - rc * cq) / determinant, (rr * cq - rc * rq) / determinant, true};
    }

    ScalarImage image_;
    const bool* known_;
    std::ptrdiff_t height_, width_;
    std::vector<Slopes> slopes_;
    /// On the current pixel.
    std::vector<Opinion> opinions_;
};

}  // namespace

void complete_depth(const ScalarImage& inverse_depth, const bool* known, float* completed) {
    Completion completion(inverse_depth, known);
    for (std::size_t y = 0; y < inverse_depth.height; ++y) {
        for (std::size_t x = 0; x < inverse_depth.width; ++x) {
            const std::size_t pixel = y * inverse_depth.width + x;
            completed[pixel] = known[pixel] ? inverse_depth.data[pixel]
                                            : completion.at(static_cast<std::ptrdiff_t>(y),
                                                            static_cast<std::ptrdiff_t>(x));
        }
    }
}

}  // namespace lfnav::LFNAV_LEVEL
