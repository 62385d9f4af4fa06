// Depth maps of neighbouring views brought to agree (Merrell and others 2007), as
// pipelines/lightfield/depth_filtering.py explains it.

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

/// What another view found.
struct NeighbourDepth {
    ScalarImage inverse_depth;
    const bool* confident;
    /// (3, 4) from its pixel (x, y) at inverse depth q to the view's homogeneous pixel
    /// map (x, y, 1, q), and from the view to it.
    const double *to_view, *from_view;
};

// Homogeneous depth below which a point counts as behind the camera.
constexpr double NEAR = 1e-6;
constexpr std::int32_t NOWHERE = -1;

/// Where the pixels of a row are in another view.
class MappedRow {
  public:
    explicit MappedRow(std::size_t width) : u_(width), v_(width), depth_(width) {
        pixel.resize(width);
        expected.resize(width);
    }

    /// For pixel and expected: which pixel of the other view shows a point, NOWHERE if none does,
    /// and at which inverse depth.
    std::vector<std::int32_t> pixel;
    std::vector<double> expected;

    void begin(const double* map, std::size_t y) {
        const auto row = static_cast<double>(y);
#pragma omp simd
        for (std::size_t x = 0; x < u_.size(); ++x) {
            const auto column = static_cast<double>(static_cast<std::int32_t>(x));
            u_[x] = map[0] * column + map[1] * row + map[2];
            v_[x] = map[4] * column + map[5] * row + map[6];
            depth_[x] = map[8] * column + map[9] * row + map[10];
        }
    }

    /// Of points at these inverse depths, one a pixel.
    void place(const double* map, const float* inverse_depths, const ScalarImage& image) {
        const double s0 = map[3], s1 = map[7], s2 = map[11];
        const auto width = static_cast<std::int32_t>(image.width);
        const auto height = static_cast<std::int32_t>(image.height);
        const double right = static_cast<double>(image.width) - 0.5;
        const double bottom = static_cast<double>(image.height) - 0.5;
        const double *const us = u_.data(), *const vs = v_.data(), *const depths = depth_.data();
        std::int32_t* const pixels = pixel.data();
        double* const found = expected.data();
#pragma omp simd
        for (std::size_t x = 0; x < u_.size(); ++x) {
            const auto q = static_cast<double>(inverse_depths[x]);
            const double depth = depths[x] + q * s2;
            const double u = (us[x] + q * s0) / depth, v = (vs[x] + q * s1) / depth;
            const bool is_seen =
                (depth > NEAR) & (u >= -0.5) & (u < right) & (v >= -0.5) & (v < bottom);
            const auto column = static_cast<std::int32_t>((is_seen ? u : 0.0) + 0.5);
            const auto line = static_cast<std::int32_t>((is_seen ? v : 0.0) + 0.5);
            // Just below a half rounds up: in an image of one column, to one that is not there.
            const std::int32_t inner_column = column < width ? column : width - 1;
            const std::int32_t inner_line = line < height ? line : height - 1;
            pixels[x] = is_seen ? inner_line * width + inner_column : NOWHERE;
            found[x] = q / depth;
        }
    }

  private:
    std::vector<double> u_, v_, depth_;
};

/// Adds what a neighbour's depth map is in the view, the nearest surface where several meet.
inline void project(const NeighbourDepth& neighbour, const ScalarImage& own, float* projected) {
    const ScalarImage& image = neighbour.inverse_depth;
    MappedRow row(image.width);
    for (std::size_t y = 0; y < image.height; ++y) {
        row.begin(neighbour.to_view, y);
        row.place(neighbour.to_view, image.row(y), own);
        for (std::size_t x = 0; x < image.width; ++x) {
            if (row.pixel[x] != NOWHERE) {
                float& nearest = projected[static_cast<std::size_t>(row.pixel[x])];
                nearest = std::max(nearest, static_cast<float>(row.expected[x]));
            }
        }
    }
}

/// Candidates for the depths of a row: inverse depths, and who sees them and sees through them.
struct Candidate {
    const float* inverse_depth;
    std::vector<float> support, violation;
};

/// Takes at each pixel the depth that most neighbours see and fewest see through, and averages all
/// depths that agree with it.
///
/// @param own: the view's inverse depths; 0, as in all maps: none.
/// @param unsure_trust: what a neighbour's depth counts where it is not confident; else 1.
/// @param agreement: share of the inverse depth within which depths are of the same surface.
/// @param fused: (H, W) receives inverse depths.
/// @param votes: (H, W) receives neighbours that see the surface less those that see through it.
inline void fuse_depth(const ScalarImage& own, std::span<const NeighbourDepth> neighbours,
                       float unsure_trust, double agreement, float* fused, float* votes) {
    const std::size_t pixels = own.height * own.width, width = own.width;
    std::vector<float> projected(neighbours.size() * pixels);
    for (std::size_t i = 0; i < neighbours.size(); ++i) {
        project(neighbours[i], own, projected.data() + i * pixels);
    }
    std::vector<Candidate> candidates(neighbours.size() + 1);
    MappedRow mapped(width);
    for (std::size_t y = 0; y < own.height; ++y) {
        for (std::size_t i = 0; i < candidates.size(); ++i) {
            candidates[i].inverse_depth =
                i == 0 ? own.row(y) : projected.data() + (i - 1) * pixels + y * width;
            candidates[i].support.assign(width, 0.0F);
            candidates[i].violation.assign(width, 0.0F);
        }
        for (const NeighbourDepth& neighbour : neighbours) {
            mapped.begin(neighbour.from_view, y);
            for (Candidate& candidate : candidates) {
                mapped.place(neighbour.from_view, candidate.inverse_depth, neighbour.inverse_depth);
                for (std::size_t x = 0; x < width; ++x) {
                    if (mapped.pixel[x] == NOWHERE || !(candidate.inverse_depth[x] > 0.0F)) {
                        continue;
                    }
                    const auto pixel = static_cast<std::size_t>(mapped.pixel[x]);
                    const auto found = static_cast<double>(neighbour.inverse_depth.data[pixel]);
                    const double expected = mapped.expected[x];
                    const float trust = neighbour.confident[pixel] ? 1.0F : unsure_trust;
                    const bool is_same = std::abs(found - expected) <= agreement * expected;
                    candidate.support[x] += is_same ? trust : 0.0F;
                    candidate.violation[x] += !is_same && found < expected ? trust : 0.0F;
                }
            }
        }
        for (std::size_t x = 0; x < width; ++x) {
            const auto standing = [&](const Candidate& candidate) {
                return candidate.support[x] - candidate.violation[x];
            };
            const Candidate* best = candidates.data();
            // Another depth than the view's own has to be better by more than this.
            float most = standing(*best) + 0.5F;
            for (const Candidate& candidate : candidates) {
                if (candidate.inverse_depth[x] > 0.0F && standing(candidate) > most) {
                    best = &candidate;
                    most = standing(candidate);
                }
            }
            const auto middle = static_cast<double>(best->inverse_depth[x]);
            double total = 0.0, members = 0.0;
            for (const Candidate& candidate : candidates) {
                const auto value = static_cast<double>(candidate.inverse_depth[x]);
                if (std::abs(value - middle) <= agreement * middle) {
                    total += value;
                    members += 1.0;
                }
            }
            fused[y * width + x] = static_cast<float>(total / members);
            votes[y * width + x] = standing(*best);
        }
    }
}

}  // namespace lfnav::LFNAV_LEVEL
