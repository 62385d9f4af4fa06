// The photos that show surface points best: the ranking of unstructured-lumigraph rendering
// (Buehler and others 2001), as pipelines/render/blending.py explains it.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "homography.hpp"
#include "level.hpp"
#include "light_field.hpp"
#include "occlusion.hpp"
#include "simd.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Points that are ranked together.
constexpr std::size_t POINTS = 16;
/// Photos that share the weight at a point, and one more with which they are compared.
constexpr std::size_t SHARING = 3, RANKS = SHARING + 1;
constexpr float NEVER = std::numeric_limits<float>::infinity();

/// Surface points, in the coordinates of the index: where they are, the unit direction from the
/// virtual camera to them, and one over their distance from it. What is nowhere is no number.
struct SurfacePoints {
    alignas(64) float x[POINTS], y[POINTS], z[POINTS];
    alignas(64) float direction_x[POINTS], direction_y[POINTS], direction_z[POINTS];
    alignas(64) float inverse_distance[POINTS];
};

/// The best photos at points, the best first; the penalty is infinite where there is none.
struct BestPhotos {
    alignas(64) float penalty[RANKS][POINTS];
    alignas(64) std::int32_t photo[RANKS][POINTS];
};

LFNAV_INLINE void set_points(const VirtualCamera& camera, const double* origin,
                             const float* columns, const float* rows, const float* inverse_depths,
                             SurfacePoints& points) {
    // Metres; what lies beyond is taken to be as far away as this: single precision ends somewhere.
    constexpr double FARTHEST = 1e7;
    const double* const r = camera.rays;
    const double r0 = r[0], r1 = r[1], r2 = r[2], r3 = r[3], r4 = r[4], r5 = r[5], r6 = r[6],
                 r7 = r[7], r8 = r[8];
    const double cx = camera.pose[3] - origin[0], cy = camera.pose[7] - origin[1],
                 cz = camera.pose[11] - origin[2];
#pragma omp simd
    for (std::size_t i = 0; i < POINTS; ++i) {
        const double x = static_cast<double>(columns[i]), y = static_cast<double>(rows[i]);
        const auto inverse_depth = static_cast<double>(inverse_depths[i]);
        const double bounded = inverse_depth > 1.0 / FARTHEST ? inverse_depth : 1.0 / FARTHEST;
        const double distance =
            inverse_depth > 0.0 ? 1.0 / bounded : std::numeric_limits<double>::quiet_NaN();
        const double rx = r0 * x + r1 * y + r2, ry = r3 * x + r4 * y + r5,
                     rz = r6 * x + r7 * y + r8;
        const double shrink = 1.0 / std::sqrt(rx * rx + ry * ry + rz * rz);
        points.x[i] = static_cast<float>(cx + distance * rx);
        points.y[i] = static_cast<float>(cy + distance * ry);
        points.z[i] = static_cast<float>(cz + distance * rz);
        points.direction_x[i] = static_cast<float>(rx * shrink);
        points.direction_y[i] = static_cast<float>(ry * shrink);
        points.direction_z[i] = static_cast<float>(rz * shrink);
        points.inverse_distance[i] = static_cast<float>(shrink / distance);
    }
}

/// A surface point, or as many as a vector has numbers.
template <typename Vector>
struct PointVector {
    Vector x, y, z, direction_x, direction_y, direction_z, inverse_distance;

    /// Points that follow each other.
    LFNAV_INLINE static PointVector at(const SurfacePoints& points, std::size_t i) {
        return {loaded<Vector>(points.x + i),
                loaded<Vector>(points.y + i),
                loaded<Vector>(points.z + i),
                loaded<Vector>(points.direction_x + i),
                loaded<Vector>(points.direction_y + i),
                loaded<Vector>(points.direction_z + i),
                loaded<Vector>(points.inverse_distance + i)};
    }

    /// The same point everywhere.
    LFNAV_INLINE static PointVector repeated(const SurfacePoints& points, std::size_t i) {
        const Vector zero = {};
        return {zero + points.x[i],
                zero + points.y[i],
                zero + points.z[i],
                zero + points.direction_x[i],
                zero + points.direction_y[i],
                zero + points.direction_z[i],
                zero + points.inverse_distance[i]};
    }
};

/// How far a point's ray from a place is from that of the virtual camera, and its distance.
template <typename Vector>
struct Deviation {
    /// Chord between unit vectors: no cosine near 1 whose digits would be lost.
    Vector chord;
    Vector distance;

    LFNAV_INLINE Deviation(const PointVector<Vector>& point, const Vector& x, const Vector& y,
                           const Vector& z) {
        const Vector rx = point.x - x, ry = point.y - y, rz = point.z - z;
        distance = square_root(rx * rx + ry * ry + rz * rz);
        const Vector shrink = 1.0F / distance;
        const Vector ex = rx * shrink - point.direction_x, ey = ry * shrink - point.direction_y,
                     ez = rz * shrink - point.direction_z;
        chord = square_root(ex * ex + ey * ey + ez * ez);
    }
};

/// What a photo has of a point: its penalty, infinite where the photo does not show the point; and
/// where the point is in it, columns and rows times the depth.
template <typename Vector>
struct Sight {
    Vector penalty, u, v, depth;
};

/// @param number: gives the photo's numbers, see PhotoIndex, as vectors.
template <typename Vector, typename NumberAt>
LFNAV_INLINE Sight<Vector> sight_of(const PointVector<Vector>& point, NumberAt number,
                                    const PenaltySettings& settings) {
    const Vector zero = {};
    const auto row = [&](std::size_t first) __attribute__((always_inline)) {
        return number(first) * point.x + number(first + 1) * point.y +
               (number(first + 2) * point.z + number(first + 3));
    };
    const Vector u = row(0), v = row(4), depth = row(8);
    const Deviation<Vector> from(point, number(12), number(13), number(14));
    const Vector coarser = larger(from.distance * point.inverse_distance - 1.0F, zero);
    // All times the depth, which spares a division.
    const Vector half = 0.5F * depth, strip = number(17) * depth;
    const Vector across = smaller(u + half, number(15) * depth - half - u);
    const Vector along = smaller(v + half, number(16) * depth - half - v);
    const Vector margin = smaller(across, along);
    const Vector near_border = strip / larger(margin, settings.smallest_margin * strip) - 1.0F;
    const Vector penalty =
        from.chord + settings.resolution * coarser + settings.border * larger(near_border, zero);
    return {((depth > zero) & (margin >= zero)) ? penalty : zero + NEVER, u, v, depth};
}

/// A photo's penalties without those of points before which it has something nearer.
LFNAV_INLINE FloatVector without_hidden(const Sight<FloatVector>& sight, const DepthMap& map) {
    const FloatVector zero = {}, inverse_depth = 1.0F / sight.depth;
    const IntegerVector is_hidden =
        map.hides(sight.u * inverse_depth, sight.v * inverse_depth, inverse_depth);
    return is_hidden != 0 ? zero + NEVER : sight.penalty;
}

/// Finds the photos with the smallest penalties; of equal ones the first stays.
///
/// @tparam MAY_BE_HIDDEN: whether depth maps may hide the points.
/// @param rows: those of the index that are ranked, rising.
template <bool MAY_BE_HIDDEN>
LFNAV_INLINE void rank_photos(const SurfacePoints& points, const Photos& photos,
                              const PhotoIndex& index, const std::int32_t* rows, std::size_t count,
                              const PenaltySettings& settings, BestPhotos& best) {
    using Vector = FloatVector;
    using Integers = IntegerVector;
    const Vector zero = {};
    const Integers none = {};
    for (std::size_t i = 0; i < POINTS; i += BYTES / sizeof(float)) {
        const auto point = PointVector<Vector>::at(points, i);
        Vector p0 = zero + NEVER, p1 = p0, p2 = p0, p3 = p0;
        Integers v0 = none - 1, v1 = v0, v2 = v0, v3 = v0;
        for (std::size_t number = 0; number < count; ++number) {
            const auto row = static_cast<std::size_t>(rows[number]);
            const float* const numbers = index.numbers + PhotoIndex::PHOTO_NUMBERS * row;
            const auto repeated = [&](std::size_t place) __attribute__((always_inline)) {
                return zero + numbers[place];
            };
            const Sight<Vector> sight = sight_of(point, repeated, settings);
            Vector own = sight.penalty;
            if constexpr (MAY_BE_HIDDEN) {
                // Where it is none of the best, nobody needs to know.
                if (any_of(own < p3)) {
                    const auto photo = static_cast<std::size_t>(index.order[row]);
                    const DepthMap map(photos, photo, photos.size_of(photo));
                    own = map.is_there ? without_hidden(sight, map) : own;
                }
            }
            const Integers photo = none + index.order[row];
            const auto b0 = own < p0, b1 = own < p1, b2 = own < p2, b3 = own < p3;
            v3 = b2 ? v2 : (b3 ? photo : v3);
            v2 = b1 ? v1 : (b2 ? photo : v2);
            v1 = b0 ? v0 : (b1 ? photo : v1);
            v0 = b0 ? photo : v0;
            p3 = larger(p2, smaller(p3, own));
            p2 = larger(p1, smaller(p2, own));
            p1 = larger(p0, smaller(p1, own));
            p0 = smaller(p0, own);
        }
        const Vector penalties[RANKS] = {p0, p1, p2, p3};
        const Integers numbers[RANKS] = {v0, v1, v2, v3};
        for (std::size_t rank = 0; rank < RANKS; ++rank) {
            store(penalties[rank], best.penalty[rank] + i);
            store(numbers[rank], best.photo[rank] + i);
        }
    }
}

/// Weights with sum 1, which fall to zero where the next photo takes over.
///
/// @param weights: (SHARING, POINTS) receives them.
LFNAV_INLINE void set_shares(const BestPhotos& best, const PenaltySettings& settings,
                             float* weights) {
    using Vector = FloatVector;
    const Vector zero = {}, one = zero + 1.0F, smallest = zero + settings.smallest;
    for (std::size_t i = 0; i < POINTS; i += BYTES / sizeof(float)) {
        const Vector p0 = loaded<Vector>(best.penalty[0] + i);
        const Vector p1 = loaded<Vector>(best.penalty[1] + i);
        const Vector p2 = loaded<Vector>(best.penalty[2] + i);
        const Vector scale =
            1.0F / larger(loaded<Vector>(best.penalty[3] + i), smallest + smallest);
        const auto share = [&](const Vector& penalty) __attribute__((always_inline)) {
            const Vector own = larger(1.0F - penalty * scale, zero) / larger(penalty, smallest);
            return penalty < zero + NEVER ? own : zero;
        };
        const Vector w0 = share(p0), w1 = share(p1), w2 = share(p2), total = w0 + w1 + w2;
        const Vector found =
            one + (p1 < zero + NEVER ? one : zero) + (p2 < zero + NEVER ? one : zero);
        // Where all are as good as the next one, they share alike.
        const auto differ = total > zero;
        const Vector factor = 1.0F / (differ ? total : found);
        store((differ ? w0 : one) * factor, weights + i);
        store((differ ? w1 : one) * factor, weights + POINTS + i);
        store((differ ? w2 : one) * factor, weights + 2 * POINTS + i);
    }
}

}  // namespace lfnav::LFNAV_LEVEL
