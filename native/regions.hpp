// Regions of the virtual image, each with some photos and weights that are bilinear in the pixel,
// and the pixels that are in them: put together run by run, then sorted.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "homography.hpp"
#include "level.hpp"
#include "ranking.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Photos that are blended in a region: of a tile those of its four corners.
constexpr std::size_t MOST_BLENDED = 4 * SHARING;

/// A region's photos and the weights a x + b y + c + d x y of each. ImagePoints x, y count from a
/// pixel of the region, which is at (left, top) from the image's middle: weights may be steep.
struct Region {
    std::size_t count;
    std::int32_t photo[MOST_BLENDED];
    float a[MOST_BLENDED], b[MOST_BLENDED], c[MOST_BLENDED], d[MOST_BLENDED];
    float left, top;
};

/// Pixels, region by region; so many numbers behind the last one may be read and written, too.
struct RegionPixels {
    explicit RegionPixels(std::size_t count)
        : x(count + TOGETHER), y(count + TOGETHER), place(count + TOGETHER) {}

    /// Where each region's pixels begin, and the end of the last one's.
    std::vector<std::size_t> starts;
    /// Where they are, from the image's middle, and which they are in the order of the image.
    std::vector<float> x, y;
    std::vector<std::int32_t> place;
};

/// Makes one map after the other in the same memory.
class RegionMap {
  public:
    /// @param pixels: those that are rendered, indices in the image, rising.
    RegionMap(std::size_t width, std::size_t height, std::span<const std::int32_t> pixels,
              const Middle& middle)
        : width_(width),
          middle_(middle),
          x_(pixels.size()),
          y_(pixels.size()),
          before_(height * (width + 1)),
          pixels_(pixels.size()) {
        const auto across = static_cast<std::int32_t>(width);
        std::size_t count = 0, place = 0;
        for (std::int32_t row = 0; row < static_cast<std::int32_t>(height); ++row) {
            for (std::int32_t column = 0; column <= across; ++column) {
                before_[place++] = static_cast<std::int32_t>(count);
                const bool is_next = count < pixels.size() && column < across &&
                                     pixels[count] == row * across + column;
                count += is_next ? 1 : 0;
            }
        }
        for (std::size_t i = 0; i < pixels.size(); ++i) {
            const std::int32_t column = pixels[i] % across, row = pixels[i] / across;
            x_[i] = static_cast<float>(column - middle.x);
            y_[i] = static_cast<float>(row - middle.y);
        }
    }

    std::span<const Region> regions() const { return regions_; }
    std::span<Region> regions() { return regions_; }
    const RegionPixels& pixels() const { return pixels_; }

    void clear() {
        regions_.clear();
        runs_.clear();
    }

    /// How many of the pixels are before a place; a row's last column may be one behind its end.
    std::int32_t before(std::size_t row, std::size_t column) const {
        return before_[row * (width_ + 1) + column];
    }

    /// Column and row of one of the pixels.
    std::pair<double, double> place_of(std::int32_t pixel) const {
        return {static_cast<double>(x_[index(pixel)]) + middle_.x,
                static_cast<double>(y_[index(pixel)]) + middle_.y};
    }

    /// Adds a region whose weights count from a place; returns its number.
    std::int32_t add(std::size_t column, std::size_t row) {
        Region& region = regions_.emplace_back();
        region.left = static_cast<float>(static_cast<std::int32_t>(column) - middle_.x);
        region.top = static_cast<float>(static_cast<std::int32_t>(row) - middle_.y);
        return static_cast<std::int32_t>(regions_.size()) - 1;
    }

    /// Adds a photo to the last region, with weight a x + b y + c.
    void add_photo(std::int32_t photo, double a, double b, double c) {
        Region& region = regions_.back();
        const std::size_t slot = region.count++;
        region.photo[slot] = photo;
        region.a[slot] = static_cast<float>(a);
        region.b[slot] = static_cast<float>(b);
        region.c[slot] = static_cast<float>(c);
    }

    /// Adds pixels that follow each other to a region.
    void add_run(std::int32_t region, std::int32_t first, std::int32_t end) {
        if (first < end) {
            runs_.push_back({region, first, end});
        }
    }

    /// Sorts the pixels by their regions.
    LFNAV_INLINE void sort_pixels() {
        std::vector<std::size_t>& starts = pixels_.starts;
        starts.assign(regions_.size() + 2, 0);
        if (!regions_.empty()) {
            std::size_t total = 0;
            for (const Run& run : runs_) {
                total += index(run.end - run.first);
            }
            if (total != x_.size()) {
                separate_runs();
            }
        }
        // Two behind its own place: what begins there moves on to its end.
        for (const Run& run : runs_) {
            starts[index(run.region) + 2] += index(run.end - run.first);
        }
        for (std::size_t region = 0; region < regions_.size(); ++region) {
            starts[region + 2] += starts[region + 1];
        }
        for (const Run& run : runs_) {
            std::size_t& start = starts[index(run.region) + 1];
            const std::size_t first = index(run.first), count = index(run.end - run.first);
            for (std::size_t i = 0; i < count; ++i) {
                pixels_.x[start + i] = x_[first + i];
                pixels_.y[start + i] = y_[first + i];
                pixels_.place[start + i] = run.first + static_cast<std::int32_t>(i);
            }
            start += count;
        }
        starts.pop_back();
    }

  private:
    /// Pixels of a region that follow each other.
    struct Run {
        std::int32_t region, first, end;
    };

    static std::size_t index(std::int32_t i) { return static_cast<std::size_t>(i); }

    /// Gives each pixel one region, where rounding left some to none or to several.
    void separate_runs() {
        region_of_.assign(x_.size(), 0);
        for (const Run& run : runs_) {
            std::fill(region_of_.begin() + run.first, region_of_.begin() + run.end, run.region);
        }
        runs_.clear();
        for (std::size_t i = 0; i < x_.size(); ++i) {
            const auto pixel = static_cast<std::int32_t>(i);
            runs_.push_back({region_of_[i], pixel, pixel + 1});
        }
    }

    std::size_t width_;
    Middle middle_;
    /// Of the pixels, from the image's middle; and how many of them are before each place, with one
    /// more place behind each row.
    std::vector<float> x_, y_;
    std::vector<std::int32_t> before_, region_of_;
    std::vector<Run> runs_;
    std::vector<Region> regions_;
    RegionPixels pixels_;
};

}  // namespace lfnav::LFNAV_LEVEL
