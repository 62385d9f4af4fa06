// The surface that depth maps describe, as a virtual camera sees it: a grid of vertices, which is
// recomputed for each camera. The readable version is pipelines/render/surface.py.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "homography.hpp"
#include "level.hpp"
#include "splatting.hpp"
#include "surface.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

class DepthSurface final : public Surface {
  public:
    DepthSurface(const LightField& field, const VirtualViews& views, const DepthSamples& samples)
        : photos_(field.photos),
          settings_(field.depth_grid),
          views_(views),
          samples_(samples),
          grid_{side(views.width), side(views.height)},
          nearest_(grid_.count() + Splatting::ELSEWHERE),
          vertices_(grid_.count()) {}

    void prepare(ImagePoints& points) const override {
        const std::size_t count = points.count();
        points.vertex.resize(count + TOGETHER);
        points.right.resize(count + TOGETHER);
        points.below.resize(count + TOGETHER);
        for (std::size_t i = 0; i < count; ++i) {
            const double x = static_cast<double>(points.x[i]) / views_.spacing;
            const double y = static_cast<double>(points.y[i]) / views_.spacing;
            const std::size_t column = std::min(static_cast<std::size_t>(x), grid_.width - 1);
            const std::size_t row = std::min(static_cast<std::size_t>(y), grid_.height - 1);
            points.vertex[i] = static_cast<std::int32_t>((row + 1) * grid_.stride() + column + 1);
            points.right[i] = static_cast<float>(x - static_cast<double>(column));
            points.below[i] = static_cast<float>(y - static_cast<double>(row));
        }
    }

    void set_camera(const VirtualCamera& camera, std::size_t number) override {
        std::fill(nearest_.begin(), nearest_.end(), 0.0F);
        const std::int32_t* const sources = views_.sources + views_.most_sources * number;
        for (std::size_t i = 0; i < views_.most_sources && sources[i] >= 0; ++i) {
            const auto photo = static_cast<std::size_t>(sources[i]);
            const DepthProjection projection(photos_, photo, camera, views_.spacing, grid_);
            splatting_(samples_, photo, projection, grid_, nearest_.data());
        }
        keep_solid();
        close_gaps();
        // Cells to the right of the last vertices, and below them, have the same on both sides.
        const std::size_t stride = grid_.stride();
        for (std::size_t row = 1; row <= grid_.height; ++row) {
            vertices_[row * stride + grid_.width + 1] = vertices_[row * stride + grid_.width];
        }
        std::copy_n(vertices_.end() - 2 * signed_stride(), stride,
                    vertices_.end() - signed_stride());
    }

    /// Bilinear between vertices of one surface; across an edge, or a gap, the nearest vertex.
    void set_inverse_depths(const ImagePoints& points, float* inverse_depths) const override {
        const std::size_t count = points.count();
        const auto stride = static_cast<std::int32_t>(grid_.stride());
        const float* const vertices = vertices_.data();
        const float edge = settings_.edge_factor;
#pragma omp simd
        for (std::size_t i = 0; i < count; ++i) {
            const std::int32_t vertex = points.vertex[i];
            const float a = vertices[vertex], b = vertices[vertex + 1];
            const float c = vertices[vertex + stride], d = vertices[vertex + stride + 1];
            const float low = std::min(std::min(a, b), std::min(c, d));
            const float high = std::max(std::max(a, b), std::max(c, d));
            const float right = points.right[i], below = points.below[i];
            const float left_side = a + (c - a) * below, right_side = b + (d - b) * below;
            const float between = left_side + (right_side - left_side) * right;
            const float upper = right >= 0.5F ? b : a, lower = right >= 0.5F ? d : c;
            const float nearest = below >= 0.5F ? lower : upper;
            inverse_depths[i] = ((low > 0.0F) & (high <= edge * low)) ? between : nearest;
        }
    }

  private:
    std::size_t side(std::size_t pixels) const {
        return static_cast<std::size_t>(
                   std::ceil(static_cast<double>(pixels - 1) / views_.spacing)) +
               1;
    }

    std::ptrdiff_t signed_stride() const { return static_cast<std::ptrdiff_t>(grid_.stride()); }

    /// Takes the vertices over but for those that show the background between foreground points.
    LFNAV_INLINE void keep_solid() {
        const std::size_t stride = grid_.stride();
        const float factor = settings_.pinhole_factor;
        const std::int32_t most = settings_.pinhole_neighbours;
        // The border is neither empty nor known.
        std::fill(vertices_.begin(), vertices_.end(), BORDER);
        for (std::size_t row = 1; row <= grid_.height; ++row) {
            const float* const own = nearest_.data() + row * stride + 1;
            const float *const above = own - stride, *const below = own + stride;
            float* const result = vertices_.data() + row * stride + 1;
#pragma omp simd
            for (std::size_t i = 0; i < grid_.width; ++i) {
                const float limit = factor * own[i];
                const auto is_nearer = [&](const float* at) __attribute__((always_inline)) {
                    return at[i] > limit ? 1 : 0;
                };
                const std::int32_t nearer = is_nearer(own - 1) + is_nearer(own + 1) +
                                            is_nearer(above - 1) + is_nearer(above) +
                                            is_nearer(above + 1) + is_nearer(below - 1) +
                                            is_nearer(below) + is_nearer(below + 1);
                result[i] = nearer >= most ? 0.0F : own[i];
            }
        }
    }

    /// Fills empty vertices from the farthest known neighbour, again and again: what appears behind
    /// an edge is far.
    LFNAV_INLINE void close_gaps() {
        const std::size_t stride = grid_.stride();
        const std::size_t around[8] = {stride + 1,      stride,      stride - 1, 1,
                                       -std::size_t{1}, -stride + 1, -stride,    -stride - 1};
        const double longest = static_cast<double>(std::max(grid_.width, grid_.height));
        const auto rounds = static_cast<std::size_t>(settings_.largest_gap_share * longest) + 1;
        waiting_.clear();
        for (std::size_t i = stride; i < stride * (grid_.height + 1); ++i) {
            if (vertices_[i] == 0.0F) {
                waiting_.push_back(i);
            }
        }
        for (std::size_t round = 0; round < rounds && !waiting_.empty(); ++round) {
            filled_.clear();
            for (const std::size_t place : waiting_) {
                float smallest = std::numeric_limits<float>::infinity();
                for (const std::size_t step : around) {
                    const float value = vertices_[place + step];
                    smallest = value > 0.0F && value < smallest ? value : smallest;
                }
                if (smallest < std::numeric_limits<float>::infinity()) {
                    filled_.push_back({place, smallest});
                }
            }
            for (const auto& [place, value] : filled_) {
                vertices_[place] = value;
            }
            // After that only neighbours of what was filled can be.
            waiting_.clear();
            for (const auto& [place, value] : filled_) {
                for (const std::size_t step : around) {
                    if (vertices_[place + step] == 0.0F) {
                        vertices_[place + step] = WAITING;
                        waiting_.push_back(place + step);
                    }
                }
            }
        }
        for (const std::size_t place : waiting_) {
            vertices_[place] = 0.0F;
        }
    }

    static constexpr float BORDER = -1.0F, WAITING = -2.0F;
    struct Filled {
        std::size_t place;
        float value;
    };

    Photos photos_;
    DepthGridSettings settings_;
    VirtualViews views_;
    DepthSamples samples_;
    VertexGrid grid_;
    /// Inverse depths: the nearest sample at each vertex, and what is left of them.
    std::vector<float> nearest_, vertices_;
    std::vector<std::size_t> waiting_;
    std::vector<Filled> filled_;
    Splatting splatting_;
};

}  // namespace lfnav::LFNAV_LEVEL
