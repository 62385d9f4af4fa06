// Candidate view selection: of very many photos those that are the best at any of a few points.
//
// At each point only those groups of photos are looked at that may hold one better than the best so
// far: the angle between a ray to the point and any ray from inside a sphere differs from that to
// the sphere's centre by no more than the sphere's own angle allows, and no photo shows what is
// outside of the planes around all that the group's photos show.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "light_field.hpp"
#include "ranking.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Writes what the penalties of a group's photos are no smaller than at each point.
///
/// For vectors p, q: |p/|p| - q/|q|| <= 2 |p - q| / (|p| + |q|) (Dunkl and Williams 1964).
LFNAV_INLINE void set_bounds(const SurfacePoints& points, const float* group,
                             const PenaltySettings& settings, float* bounds) {
    using Vector = FloatVector;
    // Bounds in single precision are smaller than they should be by less than this.
    constexpr float ROUNDING = 1e-5F;
    const Vector zero = {};
    const float radius = group[3];
    for (std::size_t i = 0; i < POINTS; i += BYTES / sizeof(float)) {
        const auto point = PointVector<Vector>::at(points, i);
        const Vector x = zero + group[0], y = zero + group[1], z = zero + group[2];
        const Deviation<Vector> from(point, x, y, z);
        const Vector slack =
            2.0F * radius / larger(2.0F * from.distance - radius, zero + ROUNDING * radius);
        const Vector coarser =
            larger((from.distance - radius) * point.inverse_distance - 1.0F, zero);
        const Vector bound = from.chord - slack + settings.resolution * coarser - ROUNDING;
        const Vector rx = point.x - x, ry = point.y - y, rz = point.z - z;
        // How far the point may be on the inner side of the planes for each side of the images, too
        // small by the radius at most.
        const auto inside = [&](const float* plane) __attribute__((always_inline)) {
            return plane[0] * rx + plane[1] * ry + plane[2] * rz +
                   (plane[3] + ROUNDING) * from.distance;
        };
        const Vector innermost = smaller(smaller(inside(group + 4), inside(group + 8)),
                                         smaller(inside(group + 12), inside(group + 16)));
        store(innermost + radius >= zero ? bound : zero + NEVER, bounds + i);
    }
}

/// The best photo at each point.
struct CandidateViews {
    float penalty[POINTS];
    /// Rows of the index; -1: none.
    std::int32_t row[POINTS];
};

/// Whether a photo has something nearer before a point.
inline bool is_hidden(const Photos& photos, std::size_t photo, float u, float v, float depth) {
    const float inverse_depth = 1.0F / depth;
    return DepthMap(photos, photo, photos.size_of(photo))
        .hides(u * inverse_depth, v * inverse_depth, inverse_depth);
}

/// Puts the best of a group's photos there if none before it was as good at a point.
inline void compare_group(const SurfacePoints& points, const Photos& photos,
                          const PhotoIndex& index, std::size_t group,
                          const PenaltySettings& settings, std::size_t place,
                          CandidateViews& best) {
    using Vector = FloatVector;
    constexpr std::size_t PHOTOS = PhotoIndex::GROUP_PHOTOS;
    const float* const numbers = index.blocks + PhotoIndex::PHOTO_NUMBERS * PHOTOS * group;
    const auto point = PointVector<Vector>::repeated(points, place);
    alignas(64) float penalties[PHOTOS], u[PHOTOS], v[PHOTOS], depth[PHOTOS];
    for (std::size_t i = 0; i < PHOTOS; i += BYTES / sizeof(float)) {
        const auto number = [&](std::size_t row) __attribute__((always_inline)) {
            return loaded<Vector>(numbers + PHOTOS * row + i);
        };
        const Sight<Vector> sight = sight_of(point, number, settings);
        store(sight.penalty, penalties + i);
        store(sight.u, u + i);
        store(sight.v, v + i);
        store(sight.depth, depth + i);
    }
    for (std::size_t i = 0; i < PHOTOS; ++i) {
        const float own = penalties[i], before = best.penalty[place];
        const std::int32_t row = index.members[PHOTOS * group + i];
        // Of equal ones the first of all stays. Infinity stands for what is not shown.
        if ((own < before || (own == before && row < best.row[place])) &&
            !is_hidden(photos, static_cast<std::size_t>(index.order[row]), u[i], v[i], depth[i])) {
            best.penalty[place] = own;
            best.row[place] = row;
        }
    }
}

/// Finds the photo with the smallest penalty at each point.
///
/// @param bounds: (G, POINTS) overwritten.
inline void find_candidates(const SurfacePoints& points, const Photos& photos,
                            const PhotoIndex& index, const PenaltySettings& settings, float* bounds,
                            CandidateViews& best) {
    float promised[POINTS];
    std::size_t most_promising[POINTS];
    for (std::size_t i = 0; i < POINTS; ++i) {
        best.penalty[i] = promised[i] = std::numeric_limits<float>::max();
        best.row[i] = -1;
        most_promising[i] = index.groups;
    }
    for (std::size_t group = 0; group < index.groups; ++group) {
        float* const own = bounds + POINTS * group;
        set_bounds(points, index.bounds + PhotoIndex::GROUP_NUMBERS * group, settings, own);
        for (std::size_t i = 0; i < POINTS; ++i) {
            const bool promises_more = own[i] < promised[i];
            promised[i] = promises_more ? own[i] : promised[i];
            most_promising[i] = promises_more ? group : most_promising[i];
        }
    }
    // The most promising ones first spare a look at most others.
    for (std::size_t i = 0; i < POINTS; ++i) {
        if (most_promising[i] < index.groups) {
            compare_group(points, photos, index, most_promising[i], settings, i, best);
        }
    }
    for (std::size_t group = 0; group < index.groups; ++group) {
        for (std::size_t i = 0; i < POINTS; ++i) {
            // As good a one may stand before the best in the index.
            if (bounds[POINTS * group + i] <= best.penalty[i] && most_promising[i] != group) {
                compare_group(points, photos, index, group, settings, i, best);
            }
        }
    }
}

/// Writes, rising, the rows of the photos that are the best at any point; returns their number.
inline std::size_t distinct_rows(const CandidateViews& best, std::int32_t* rows) {
    std::int32_t* end =
        std::copy_if(best.row, best.row + POINTS, rows, [](std::int32_t row) { return row >= 0; });
    std::sort(rows, end);
    return static_cast<std::size_t>(std::unique(rows, end) - rows);
}

}  // namespace lfnav::LFNAV_LEVEL
