// How well photos agree that a pixel shows a surface at each of many depths: a plane sweep
// (Collins 1996), as pipelines/lightfield/stereo_depth.py explains it.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "image.hpp"
#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

/// A photo that the reference is compared with: the reference's pixel (x, y) at inverse depth q is
/// at its homogeneous pixel map (x, y, 1, q).
struct SweptPhoto {
    GreyImage image;
    /// (3, 4).
    const double* map;
};

// Costs run to about LARGEST where windows have nothing in common; UNSEEN: the photo shows nothing.
constexpr float LARGEST_COST = 240.0F, UNSEEN_COST = 255.0F;
constexpr std::uint8_t UNSEEN = 255;
// Homogeneous depth below which a point counts as behind the camera.
constexpr float NEAREST_DEPTH = 1e-6F;
// Pixels around a window's centre.
constexpr std::size_t AROUND = 8;

/// A row of an image with its border pixels repeated on both sides: (W + 2,).
using PaddedRow = std::vector<float>;

inline void repeat_border(PaddedRow& row) {
    row.front() = row[1];
    row.back() = row[row.size() - 2];
}

/// Joins four neighbouring pixels, so that interpolating between them is one read: from the lowest
/// byte top left and right, bottom left and right; beyond the image its border is repeated.
inline std::vector<std::uint32_t> joined_neighbours(const GreyImage& image) {
    std::vector<std::uint32_t> result(image.height * image.width);
    for (std::size_t y = 0; y < image.height; ++y) {
        const std::uint8_t *const upper = image.row(y), *const lower = image.row(
                                                            std::min(y + 1, image.height - 1));
        for (std::size_t x = 0; x < image.width; ++x) {
            const std::size_t next = x + 1 < image.width ? x + 1 : x;
            result[y * image.width + x] = upper[x] | std::uint32_t{upper[next]} << 8U |
                                          std::uint32_t{lower[x]} << 16U |
                                          std::uint32_t{lower[next]} << 24U;
        }
    }
    return result;
}

/// Numbers that are needed between the steps of a row, one a pixel.
struct RowScratch {
    explicit RowScratch(std::size_t width)
        : across(width), down(width), cost(width), total(width), seeing(width), place(width) {}

    std::vector<float> across, down, cost, total, seeing;
    std::vector<std::uint32_t> place;
};

/// A photo as the reference would see it if all it shows were on one plane: its last three rows.
class WarpedPhoto {
  public:
    WarpedPhoto(const SweptPhoto& photo, std::size_t width)
        : photo_(photo), texels_(joined_neighbours(photo.image)) {
        for (std::size_t i = 0; i < 3; ++i) {
            rows_[i].resize(width + 2);
            seen_[i].resize(width);
        }
    }

    const float* row(std::size_t y) const { return rows_[y % 3].data(); }
    /// 1 where the photo shows the point, else 0.
    const float* seen(std::size_t y) const { return seen_[y % 3].data(); }

    void warp(double inverse_depth, std::size_t y, RowScratch& scratch) {
        const auto start = [&](std::size_t i) {
            const double* const row = photo_.map + 4 * i;
            return static_cast<float>(row[1] * static_cast<double>(y) + row[2] +
                                      inverse_depth * row[3]);
        };
        const auto step = [&](std::size_t i) { return static_cast<float>(photo_.map[4 * i]); };
        const float u0 = start(0), v0 = start(1), w0 = start(2);
        const float du = step(0), dv = step(1), dw = step(2);
        const auto last_u = static_cast<float>(photo_.image.width - 1);
        const auto last_v = static_cast<float>(photo_.image.height - 1);
        const auto texels_across = static_cast<std::int32_t>(photo_.image.width);
        const std::size_t width = seen_[0].size();
        float *const seen = seen_[y % 3].data(), *const row = rows_[y % 3].data() + 1;
        float *const across = scratch.across.data(), *const down = scratch.down.data();
        std::uint32_t* const place = scratch.place.data();
        // Where to look, looking, and interpolating apart: the first and the last of these loops
        // are done many pixels at a time.
#pragma omp simd
        for (std::size_t x = 0; x < width; ++x) {
            const auto column = static_cast<float>(static_cast<std::int32_t>(x));
            const float depth = dw * column + w0;
            const float scale = 1.0F / (depth > NEAREST_DEPTH ? depth : NEAREST_DEPTH);
            const float u = (du * column + u0) * scale, v = (dv * column + v0) * scale;
            // Not a number becomes 0 here, and is not seen.
            const float right_u = u > 0.0F ? u : 0.0F, below_v = v > 0.0F ? v : 0.0F;
            const float inner_u = right_u < last_u ? right_u : last_u;
            const float inner_v = below_v < last_v ? below_v : last_v;
            const bool is_inside =
                (std::abs(u - inner_u) <= 0.5F) & (std::abs(v - inner_v) <= 0.5F);
            seen[x] = (is_inside & (depth > NEAREST_DEPTH)) ? 1.0F : 0.0F;
            const auto left = static_cast<std::int32_t>(inner_u);
            const auto top = static_cast<std::int32_t>(inner_v);
            across[x] = inner_u - static_cast<float>(left);
            down[x] = inner_v - static_cast<float>(top);
            place[x] = static_cast<std::uint32_t>(top * texels_across + left);
        }
        for (std::size_t x = 0; x < width; ++x) {
            place[x] = texels_[place[x]];
        }
#pragma omp simd
        for (std::size_t x = 0; x < width; ++x) {
            const auto byte = [&](std::uint32_t shift) __attribute__((always_inline)) {
                return static_cast<float>(static_cast<std::int32_t>(place[x] >> shift & 255U));
            };
            const float upper = byte(0) + across[x] * (byte(8) - byte(0));
            const float lower = byte(16) + across[x] * (byte(24) - byte(16));
            row[x] = upper + down[x] * (lower - upper);
        }
        repeat_border(rows_[y % 3]);
    }

  private:
    SweptPhoto photo_;
    std::vector<std::uint32_t> texels_;
    PaddedRow rows_[3];
    std::vector<float> seen_[3];
};

/// Three rows of an image, the first and the last repeated beyond it.
struct WindowRows {
    const float *upper, *middle, *lower;

    template <typename RowAt>
    static WindowRows at(std::size_t y, std::size_t height, RowAt row) {
        return {row(y > 0 ? y - 1 : 0), row(y), row(y + 1 < height ? y + 1 : y)};
    }

    /// Where a row of one of the pixels around the centres begins.
    LFNAV_INLINE const float* around(std::size_t k) const {
        return k < 3 ? upper + k : (k < 5 ? middle + 2 * (k - 3) : lower + (k - 5));
    }
};

/// What the windows of a row cost in a photo.
LFNAV_INLINE void window_costs(const WindowRows& own, const WindowRows& other, const float* seen,
                               float limit, std::span<float> costs) {
    constexpr float WEIGHT = LARGEST_COST / static_cast<float>(AROUND);
    float* const result = costs.data();
    const float *const centre = own.middle + 1, *const other_centre = other.middle + 1;
#pragma omp simd
    for (std::size_t x = 0; x < costs.size(); ++x) {
        float sum = 0.0F;
#pragma GCC unroll 8
        for (std::size_t k = 0; k < AROUND; ++k) {
            const float difference =
                std::abs((own.around(k)[x] - centre[x]) - (other.around(k)[x] - other_centre[x]));
            sum += difference < limit ? difference : limit;
        }
        result[x] = seen[x] == 0.0F ? UNSEEN_COST : sum * WEIGHT / limit;
    }
}

/// Keeps the lowest costs of each pixel of a row, ascending.
///
/// @param best: (k, W).
/// @param costs: (W,) overwritten.
LFNAV_INLINE void keep_best(std::span<float> best, std::span<float> costs) {
    const std::size_t width = costs.size();
    float* const cost = costs.data();
    for (std::size_t first = 0; first < best.size(); first += width) {
        float* const kept = best.data() + first;
#pragma omp simd
        for (std::size_t x = 0; x < width; ++x) {
            const float lower = kept[x] < cost[x] ? kept[x] : cost[x];
            const float higher = kept[x] < cost[x] ? cost[x] : kept[x];
            kept[x] = lower;
            cost[x] = higher;
        }
    }
}

/// The mean of the best costs, those of photos that show the point, as bytes.
LFNAV_INLINE void write_means(std::span<const float> best, std::size_t width, RowScratch& scratch,
                              std::uint8_t* row) {
    float *const total = scratch.total.data(), *const seeing = scratch.seeing.data();
    std::fill_n(total, width, 0.0F);
    std::fill_n(seeing, width, 0.0F);
    for (std::size_t first = 0; first < best.size(); first += width) {
        const float* const costs = best.data() + first;
#pragma omp simd
        for (std::size_t x = 0; x < width; ++x) {
            const bool is_seen = costs[x] < UNSEEN_COST;
            total[x] += is_seen ? costs[x] : 0.0F;
            seeing[x] += is_seen ? 1.0F : 0.0F;
        }
    }
#pragma omp simd
    for (std::size_t x = 0; x < width; ++x) {
        const float mean = total[x] / (seeing[x] > 1.0F ? seeing[x] : 1.0F) + 0.5F;
        row[x] = static_cast<std::uint8_t>(
            static_cast<std::int32_t>(seeing[x] > 0.0F ? mean : UNSEEN_COST));
    }
}

/// Brings the costs of a row from (D, W) into (W, D), and fills in where nothing is seen.
inline void finish_row(std::size_t width, std::size_t planes, std::vector<std::uint8_t>& pixels,
                       std::uint8_t* row) {
    for (std::size_t d = 0; d < planes; ++d) {
        for (std::size_t x = 0; x < width; ++x) {
            pixels[x * planes + d] = row[d * width + x];
        }
    }
    for (std::size_t x = 0; x < width; ++x) {
        std::uint8_t* const costs = pixels.data() + x * planes;
        std::uint32_t total = 0, seeing = 0;
#pragma omp simd reduction(+ : total, seeing)
        for (std::size_t d = 0; d < planes; ++d) {
            total += costs[d] == UNSEEN ? 0U : costs[d];
            seeing += costs[d] == UNSEEN ? 0U : 1U;
        }
        if (seeing < planes) {
            const auto mean = static_cast<std::uint8_t>(total / std::max(seeing, 1U));
            std::replace(costs, costs + planes, UNSEEN, mean);
        }
    }
    std::copy_n(pixels.data(), width * planes, row);
}

/// Fills the matching volume: the cost of each pixel on each plane, 0 (alike) to 240.
///
/// Windows of 3 x 3 pixels, less the grey of their centres, are compared. On a plane on which no
/// photo shows a pixel, it costs what it costs on the others on average.
///
/// @param inverse_depths: (D,) of the planes.
/// @param best: a pixel's cost is the mean of so many of its lowest ones.
/// @param saturation: grey levels; larger differences all cost the same.
/// @param volume: (H, W, D).
inline void plane_sweep(const GreyImage& reference, std::span<const SweptPhoto> photos,
                        std::span<const double> inverse_depths, std::size_t best, float saturation,
                        std::uint8_t* volume) {
    const std::size_t height = reference.height, width = reference.width;
    const std::size_t planes = inverse_depths.size();
    std::vector<PaddedRow> own(height, PaddedRow(width + 2));
    for (std::size_t y = 0; y < height; ++y) {
        std::copy_n(reference.row(y), width, own[y].begin() + 1);
        repeat_border(own[y]);
    }
    std::vector<WarpedPhoto> others;
    others.reserve(photos.size());
    for (const SweptPhoto& photo : photos) {
        others.emplace_back(photo, width);
    }
    RowScratch scratch(width);
    std::vector<float> kept(std::min(best, photos.size()) * width);
    for (std::size_t plane = 0; plane < planes; ++plane) {
        const double level = inverse_depths[plane];
        for (std::size_t y = 0; y < height; ++y) {
            std::fill(kept.begin(), kept.end(), UNSEEN_COST);
            const auto rows =
                WindowRows::at(y, height, [&](std::size_t i) { return own[i].data(); });
            for (WarpedPhoto& other : others) {
                for (std::size_t next = y == 0 ? 0 : y + 1; next < height && next <= y + 1;
                     ++next) {
                    other.warp(level, next, scratch);
                }
                const auto warped =
                    WindowRows::at(y, height, [&](std::size_t i) { return other.row(i); });
                window_costs(rows, warped, other.seen(y), saturation, scratch.cost);
                keep_best(kept, scratch.cost);
            }
            write_means(kept, width, scratch, volume + (y * planes + plane) * width);
        }
    }
    std::vector<std::uint8_t> pixels(width * planes);
    for (std::size_t y = 0; y < height; ++y) {
        finish_row(width, planes, pixels, volume + y * planes * width);
    }
}

}  // namespace lfnav::LFNAV_LEVEL
