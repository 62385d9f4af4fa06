// Surface points that a photo does not show, since its depth map has something nearer before them.
//
// Depth maps do not fit into the processor's near caches. The largest inverse depths in squares of
// them do, and leave only points near edges to be looked up.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "homography.hpp"
#include "level.hpp"
#include "light_field.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Inverse depths in rows, looked up at places in a photo.
struct DepthTable {
    const float* values;
    std::int32_t width;
    float scale_x, scale_y, last_x, last_y;

    /// Whatever the place is, it is inside of the table.
    float at(float column, float row) const {
        const float x = smaller((column + 0.5F) * scale_x, last_x);
        const float y = smaller((row + 0.5F) * scale_y, last_y);
        return values[static_cast<std::int32_t>(larger(y, 0.0F)) * width +
                      static_cast<std::int32_t>(larger(x, 0.0F))];
    }

    /// Likewise for several.
    LFNAV_INLINE FloatVector at(const FloatVector& column, const FloatVector& row) const {
        const FloatVector zero = {};
        const FloatVector x = smaller((column + 0.5F) * scale_x, zero + last_x);
        const FloatVector y = smaller((row + 0.5F) * scale_y, zero + last_y);
        const auto left = __builtin_convertvector(larger(x, zero), IntegerVector);
        const auto top = __builtin_convertvector(larger(y, zero), IntegerVector);
        return gathered(values, top * width + left);
    }
};

/// A photo's depth map, as seen from one of its levels.
struct DepthMap {
    bool is_there;
    float factor;
    DepthTable all, pooled;

    /// @param level_size: (2,) width and height.
    DepthMap(const Photos& photos, std::size_t photo, const std::int64_t* level_size) {
        const std::int64_t width = photos.depth_size[2 * photo];
        is_there = width > 0;
        factor = photos.occlusion_factor;
        const auto across = static_cast<float>(width);
        const auto down = static_cast<float>(photos.depth_size[2 * photo + 1]);
        constexpr std::int64_t side = Photos::POOLING;
        constexpr float share = 1.0F / static_cast<float>(side);
        all = {photos.inverse_depth + photos.depth_start[photo],
               static_cast<std::int32_t>(width),
               across / static_cast<float>(level_size[0]),
               down / static_cast<float>(level_size[1]),
               across - 1.0F,
               down - 1.0F};
        pooled = {photos.pooled + photos.pooled_start[photo],
                  static_cast<std::int32_t>((width + side - 1) / side),
                  share * all.scale_x,
                  share * all.scale_y,
                  share * all.last_x,
                  share * all.last_y};
    }

    /// Before which points the photo has something nearer: -1 there, 0 elsewhere.
    ///
    /// @param column: on the level, as row.
    /// @param inverse_depth: of the points in the photo.
    LFNAV_INLINE IntegerVector hides(const FloatVector& column, const FloatVector& row,
                                     const FloatVector& inverse_depth) const {
        const FloatVector limit = factor * inverse_depth;
        const IntegerVector may_hide = pooled.at(column, row) > limit;
        return any_of(may_hide) ? all.at(column, row) > limit : may_hide;
    }

    /// Whether the photo has something nearer before a point.
    bool hides(float column, float row, float inverse_depth) const {
        return is_there && all.at(column, row) > factor * inverse_depth;
    }
};

}  // namespace lfnav::LFNAV_LEVEL
