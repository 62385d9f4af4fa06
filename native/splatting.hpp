// Depth maps projected into a virtual image: of the points around a vertex the nearest stays.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "depth_samples.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "light_field.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Vertices row by row, with a border around them.
struct VertexGrid {
    std::size_t width, height;

    std::size_t stride() const { return width + 2; }
    std::size_t count() const { return stride() * (height + 2); }
};

/// From the depth map of a photo, from its middle, to vertices: coefficients of column, row, 1 and
/// inverse depth of the vertex' column and row, times the depth, and of the depth.
struct DepthProjection {
    float column[4], row[4], depth[4];
    /// Likewise what is negative outside of the grid.
    float borders[4][4];

    DepthProjection(const Photos& photos, std::size_t photo, const VirtualCamera& camera,
                    double spacing, const VertexGrid& grid) {
        const std::int64_t* const full = photos.level_size + 2 * photos.levels * photo;
        const std::int64_t* const size = photos.depth_size + 2 * photo;
        const auto width = static_cast<double>(full[0]), height = static_cast<double>(full[1]);
        const double scale_x = width / static_cast<double>(size[0]);
        const double scale_y = height / static_cast<double>(size[1]);
        const double *const rays = photos.rays + 9 * photo, *const pose = camera.pose;
        const double focal[3] = {camera.fx / spacing, camera.fy / spacing, 1.0};
        const double middle[3] = {camera.cx / spacing, camera.cy / spacing, 0.0};
        float* const rows[3] = {column, row, depth};
        for (std::size_t i = 0; i < 3; ++i) {
            double a = 0.0, b = 0.0, c = 0.0, shift = 0.0;
            for (std::size_t k = 0; k < 3; ++k) {
                const double own = focal[i] * pose[4 * k + i] + middle[i] * pose[4 * k + 2];
                a += own * rays[3 * k];
                b += own * rays[3 * k + 1];
                c += own * rays[3 * k + 2];
                shift += own * (photos.centres[3 * photo + k] - pose[4 * k + 3]);
            }
            rows[i][0] = static_cast<float>(a * scale_x);
            rows[i][1] = static_cast<float>(b * scale_y);
            rows[i][2] = static_cast<float>(0.5 * (a * (width - 1.0) + b * (height - 1.0)) + c);
            rows[i][3] = static_cast<float>(shift);
        }
        // A little beyond the border: single precision errs by less of a cell than this.
        constexpr float MARGIN = 0.01F;
        const float right = static_cast<float>(grid.width) - 0.5F + MARGIN;
        const float bottom = static_cast<float>(grid.height) - 0.5F + MARGIN;
        for (std::size_t i = 0; i < 4; ++i) {
            borders[0][i] = column[i] + (0.5F + MARGIN) * depth[i];
            borders[1][i] = right * depth[i] - column[i];
            borders[2][i] = row[i] + (0.5F + MARGIN) * depth[i];
            borders[3][i] = bottom * depth[i] - row[i];
        }
    }
};

/// Projects depth samples onto vertices; its scratch buffers are reused.
class Splatting {
  public:
    /// Behind the vertices, what is outside of them goes to so many places in rotation.
    static constexpr std::size_t ELSEWHERE = 16;

    /// @param vertices: (grid.count() + ELSEWHERE,) inverse depths, changed where a sample is
    /// nearer.
    LFNAV_INLINE void operator()(const DepthSamples& samples, std::size_t photo,
                                 const DepthProjection& projection, const VertexGrid& grid,
                                 float* vertices) {
        const auto end = static_cast<std::size_t>(samples.ends[photo]);
        for (auto first = static_cast<std::size_t>(samples.starts[photo]); first < end;
             first += DepthSamples::BATCHES) {
            float reach[DepthSamples::BATCHES];
            set_reach(samples, first, projection, reach);
            const std::size_t batches = std::min(end - first, DepthSamples::BATCHES);
            // First all are placed, then all are written: placing need not wait for that.
            std::size_t count = 0;
            for (std::size_t i = 0; i < batches; ++i) {
                if (reach[i] >= 0.0F) {
                    place(samples.values + 3 * DepthSamples::BATCH * (first + i), projection, grid,
                          count);
                    count += DepthSamples::BATCH;
                }
            }
            for (std::size_t i = 0; i < count; ++i) {
                // No branch: which samples are nearer nobody can foresee.
                const float own = inverse_depth_[i], before = vertices[vertex_[i]];
                vertices[vertex_[i]] = own > before ? own : before;
            }
        }
    }

  private:
    /// Writes how far batches reach into the grid; with less than 0 they are outside.
    LFNAV_INLINE static void set_reach(const DepthSamples& samples, std::size_t first,
                                       const DepthProjection& projection, float* reach) {
        const std::size_t length = samples.length;
        const float* const boxes = samples.boxes + first;
#pragma omp simd
        for (std::size_t i = 0; i < DepthSamples::BATCHES; ++i) {
            float lowest = std::numeric_limits<float>::infinity();
            // Beyond which border it is most: the place in it that is the least beyond each of
            // them.
            for (const auto& [a, b, c, d] : projection.borders) {
                const float middle =
                    a * boxes[i] + b * boxes[length + i] + c + d * boxes[2 * length + i];
                const float highest = middle + std::abs(a) * boxes[3 * length + i] +
                                      std::abs(b) * boxes[4 * length + i] +
                                      std::abs(d) * boxes[5 * length + i];
                lowest = highest < lowest ? highest : lowest;
            }
            reach[i] = lowest;
        }
    }

    /// To which vertices a batch of samples is nearest, and how near they are to the camera.
    LFNAV_INLINE void place(const float* values, const DepthProjection& projection,
                            const VertexGrid& grid, std::size_t target) {
        // Points nearer to the camera's plane than this share of their recorded depth do not count.
        constexpr float SMALLEST_DEPTH = 1e-9F;
        // Copies with names: no compiler but GCC takes structured bindings into the loop below.
        const auto u_of = projection.column, v_of = projection.row, w_of = projection.depth;
        const float u0 = u_of[0], u1 = u_of[1], u2 = u_of[2], u3 = u_of[3];
        const float v0 = v_of[0], v1 = v_of[1], v2 = v_of[2], v3 = v_of[3];
        const float w0 = w_of[0], w1 = w_of[1], w2 = w_of[2], w3 = w_of[3];
        const auto right = static_cast<float>(grid.width), bottom = static_cast<float>(grid.height);
        const auto stride = static_cast<std::int32_t>(grid.stride());
        const auto behind = static_cast<std::int32_t>(grid.count());
        constexpr std::size_t BATCH = DepthSamples::BATCH;
#pragma omp simd
        for (std::size_t i = 0; i < BATCH; ++i) {
            const float x = values[i], y = values[BATCH + i], value = values[2 * BATCH + i];
            const float depth = w0 * x + w1 * y + (w2 + w3 * value);
            const float reciprocal = 1.0F / depth;
            const float u = (u0 * x + u1 * y + (u2 + u3 * value)) * reciprocal + 0.5F;
            const float v = (v0 * x + v1 * y + (v2 + v3 * value)) * reciprocal + 0.5F;
            const bool is_inside =
                (depth > SMALLEST_DEPTH) & (u >= 0.0F) & (u < right) & (v >= 0.0F) & (v < bottom);
            const auto column = static_cast<std::int32_t>(is_inside ? u : 0.0F);
            const auto row = static_cast<std::int32_t>(is_inside ? v : 0.0F);
            const std::int32_t elsewhere = behind + static_cast<std::int32_t>(i % ELSEWHERE);
            vertex_[target + i] = is_inside ? (row + 1) * stride + column + 1 : elsewhere;
            inverse_depth_[target + i] = is_inside ? value * reciprocal : 0.0F;
        }
    }

    static constexpr std::size_t MOST = DepthSamples::BATCHES * DepthSamples::BATCH;
    alignas(64) std::int32_t vertex_[MOST];
    alignas(64) float inverse_depth_[MOST];
};

}  // namespace lfnav::LFNAV_LEVEL
