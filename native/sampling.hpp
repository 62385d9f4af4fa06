// Reading photos: where the surface points of some pixels are in a photo, and what it shows there.
//
// Pixels are worked on in chunks, in two steps: places and weights of all of them as plain
// arithmetic on arrays, then the photo's texels, pixel by pixel.

#pragma once

#ifdef __AVX2__
#include <immintrin.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "homography.hpp"
#include "level.hpp"
#include "light_field.hpp"
#include "occlusion.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Chunks have at most CHUNK pixels, and are filled up to a multiple of what is worked on at once.
constexpr std::size_t CHUNK = 128, CHUNK_LENGTH = CHUNK + TOGETHER;

/// Some pixels of a virtual image, and what a photo has to do with them.
struct PixelChunk {
    /// ImagePoints in the virtual image, from its middle, inverse depths, and the photo's weights.
    alignas(64) float x[CHUNK_LENGTH], y[CHUNK_LENGTH],
        inverse_depth[CHUNK_LENGTH], weight[CHUNK_LENGTH];
    /// Which pixels they are in the image that is made.
    alignas(64) std::int32_t pixel[CHUNK_LENGTH];
    /// Upper left texel in the level that is read, how far from it to the right, and the weights of
    /// the upper and the lower texels.
    alignas(64) std::int32_t texel[CHUNK_LENGTH];
    alignas(64) float fraction[CHUNK_LENGTH], upper[CHUNK_LENGTH], lower[CHUNK_LENGTH];
    /// Where in the level the surface points are, and their inverse depths in the photo, if it may
    /// have something before them.
    alignas(64) float column[CHUNK_LENGTH], row[CHUNK_LENGTH], photo_inverse_depth[CHUNK_LENGTH];
};

/// From the virtual pixel to a pyramid level of a photo: coefficients of x, y, 1 and inverse depth.
struct LevelMap {
    float u[4], v[4], depth[4];
    float right, bottom, last_x, last_y;
    std::int32_t width;
    /// Depths in (nearest, farthest] belong to the level.
    float nearest, farthest;
};

struct SampleCounts {
    std::int32_t here, elsewhere;
};

/// Sets which texels a chunk's surface points lie between; all that are not on the level get the
/// weight 0.
///
/// @param count: a multiple of TOGETHER.
/// @tparam KEEPS_POINTS: whether places in the level and inverse depths in the photo are kept.
/// @return how many the photo shows on this level, and how many on others.
template <bool KEEPS_POINTS>
LFNAV_INLINE SampleCounts place_samples(PixelChunk& chunk, std::size_t count,
                                        const LevelMap& level) {
    const float u0 = level.u[0], u1 = level.u[1], u2 = level.u[2], u3 = level.u[3];
    const float v0 = level.v[0], v1 = level.v[1], v2 = level.v[2], v3 = level.v[3];
    const float w0 = level.depth[0], w1 = level.depth[1], w2 = level.depth[2], w3 = level.depth[3];
    const float right = level.right, bottom = level.bottom, last_x = level.last_x,
                last_y = level.last_y, nearest = level.nearest, farthest = level.farthest;
    const float last_left = std::max(last_x - 1.0F, 0.0F), last_top = std::max(last_y - 1.0F, 0.0F);
    const std::int32_t width = level.width;
    std::int32_t here = 0, elsewhere = 0;
#pragma omp simd reduction(+ : here, elsewhere)
    for (std::size_t i = 0; i < count; ++i) {
        const float x = chunk.x[i], y = chunk.y[i], d = chunk.inverse_depth[i];
        const float depth = w0 * x + w1 * y + (w2 + w3 * d);
        const float reciprocal = 1.0F / depth;
        const float u = (u0 * x + u1 * y + (u2 + u3 * d)) * reciprocal;
        const float v = (v0 * x + v1 * y + (v2 + v3 * d)) * reciprocal;
        const bool is_shown = (depth > 0.0F) & (d > 0.0F) & (chunk.weight[i] > 0.0F) &
                              (u >= -0.5F) & (u <= right) & (v >= -0.5F) & (v <= bottom);
        const bool is_here = is_shown & (depth > nearest) & (depth <= farthest);
        here += is_here ? 1 : 0;
        elsewhere += (is_shown ? 1 : 0) - (is_here ? 1 : 0);
        const float weight = is_here ? chunk.weight[i] : 0.0F;
        const float column = is_here ? u : 0.0F, row = is_here ? v : 0.0F;
        if constexpr (KEEPS_POINTS) {
            chunk.column[i] = column;
            chunk.row[i] = row;
            chunk.photo_inverse_depth[i] = d * reciprocal;
        }
        const float inner_x = column > 0.0F ? column : 0.0F, inner_y = row > 0.0F ? row : 0.0F;
        const float at_x = inner_x < last_x ? inner_x : last_x;
        const float at_y = inner_y < last_y ? inner_y : last_y;
        // The texel on the right and the row below are there; at the border they get all the
        // weight.
        const auto left = static_cast<std::int32_t>(at_x < last_left ? at_x : last_left);
        const auto top = static_cast<std::int32_t>(at_y < last_top ? at_y : last_top);
        chunk.texel[i] = top * width + left;
        chunk.fraction[i] = at_x - static_cast<float>(left);
        const float lower = weight * (at_y - static_cast<float>(top));
        chunk.lower[i] = lower;
        chunk.upper[i] = weight - lower;
    }
    return {here, elsewhere};
}

using Texel = float __attribute__((vector_size(16)));
using TexelPair = float __attribute__((vector_size(32)));

/// The channels of a texel and of the next one.
LFNAV_INLINE TexelPair two_texels(const std::uint8_t* from) {
#ifdef __AVX2__
    // What GCC 12 makes of the conversion below is three times as many instructions.
    const __m128i bytes = _mm_loadl_epi64(reinterpret_cast<const __m128i*>(from));
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes));
#else
    using Bytes = std::uint8_t __attribute__((vector_size(8)));
    using Integers = std::int32_t __attribute__((vector_size(32)));
    Bytes bytes;
    std::memcpy(&bytes, from, sizeof bytes);
    return __builtin_convertvector(__builtin_convertvector(bytes, Integers), TexelPair);
#endif
}

/// Bilinear: between the left and the right one of two texels.
LFNAV_INLINE Texel between(const TexelPair& texels, float fraction) {
    const Texel left = __builtin_shufflevector(texels, texels, 0, 1, 2, 3);
    const Texel right = __builtin_shufflevector(texels, texels, 4, 5, 6, 7);
    return left + (right - left) * fraction;
}

/// Adds a chunk's weighted colours to its pixels.
///
/// @param texels: of the level.
/// @param image: (P, 4) sums of weighted colours, and of 255 times the weights.
LFNAV_INLINE void add_samples(const PixelChunk& chunk, std::size_t count,
                              const std::uint8_t* texels, std::size_t width, float* image) {
    for (std::size_t i = 0; i < count; ++i) {
        const std::uint8_t* const upper = texels + 4 * static_cast<std::size_t>(chunk.texel[i]);
        const TexelPair column =
            two_texels(upper) * chunk.upper[i] + two_texels(upper + 4 * width) * chunk.lower[i];
        float* const sums = image + 4 * static_cast<std::size_t>(chunk.pixel[i]);
        Texel total;
        std::memcpy(&total, sums, sizeof total);
        total = total + between(column, chunk.fraction[i]);
        std::memcpy(sums, &total, sizeof total);
    }
}

/// Takes the weights of points before which a photo has something nearer.
LFNAV_INLINE void leave_out_hidden(const DepthMap& map, PixelChunk& chunk, std::size_t count) {
    using Vector = FloatVector;
    const Vector zero = {};
    for (std::size_t i = 0; map.is_there && i < count; i += BYTES / sizeof(float)) {
        const auto is_hidden =
            map.hides(loaded<Vector>(chunk.column + i), loaded<Vector>(chunk.row + i),
                      loaded<Vector>(chunk.photo_inverse_depth + i));
        store(is_hidden != 0 ? zero : loaded<Vector>(chunk.upper + i), chunk.upper + i);
        store(is_hidden != 0 ? zero : loaded<Vector>(chunk.lower + i), chunk.lower + i);
    }
}

/// Adds what a photo shows of a chunk's surface points to its pixels, times the weights: each point
/// from the pyramid level whose pixels are about as large as the virtual ones.
///
/// What is behind the chunk's pixels is overwritten.
///
/// @tparam MAY_BE_HIDDEN: whether points do not count before which the photo has something nearer.
/// @param focal: of the virtual camera, pixels.
template <bool MAY_BE_HIDDEN>
void blend_chunk(const Photos& photos, std::size_t photo, const Homography& homography,
                 double focal, PixelChunk& chunk, std::size_t count, float* image) {
    const std::size_t filled = (count + TOGETHER - 1) / TOGETHER * TOGETHER;
    for (std::size_t i = 0; i < TOGETHER; ++i) {
        chunk.weight[count + i] = 0.0F;
    }
    const auto& rows = homography.rows;
    const float first_depth = rows[2][0] * chunk.x[0] + rows[2][1] * chunk.y[0] + rows[2][2] +
                              rows[2][3] * chunk.inverse_depth[0];
    // Levels change where a pixel spans sqrt(2) 2^k of the finest one's.
    const auto nearest = static_cast<float>(1.4142135623730951 * photos.focal[photo] / focal);
    const auto border = [&](std::size_t level) {
        return nearest / static_cast<float>(std::uint64_t{1} << level);
    };
    const std::int64_t* const sizes = photos.size_of(photo);
    // Most chunks need one level, that of their first pixel; others are gone through.
    std::size_t guess = 0;
    while (guess + 1 < photos.levels && first_depth <= border(guess + 1)) {
        ++guess;
    }
    for (std::size_t turn = 0; turn < photos.levels; ++turn) {
        const std::size_t number = turn == 0 ? guess : (turn <= guess ? turn - 1 : turn);
        const auto width = static_cast<float>(sizes[2 * number]);
        const auto height = static_cast<float>(sizes[2 * number + 1]);
        const float scale_x = width / static_cast<float>(sizes[0]);
        const float scale_y = height / static_cast<float>(sizes[1]);
        LevelMap level;
        for (std::size_t i = 0; i < 4; ++i) {
            // A pixel's middle is half of one from its corner, on all levels.
            level.u[i] = scale_x * rows[0][i] + (0.5F * scale_x - 0.5F) * rows[2][i];
            level.v[i] = scale_y * rows[1][i] + (0.5F * scale_y - 0.5F) * rows[2][i];
            level.depth[i] = rows[2][i];
        }
        level.right = width - 0.5F;
        level.bottom = height - 0.5F;
        level.last_x = width - 1.0F;
        level.last_y = height - 1.0F;
        level.width = static_cast<std::int32_t>(sizes[2 * number]);
        level.nearest = number + 1 < photos.levels ? border(number + 1) : 0.0F;
        level.farthest = number > 0 ? border(number) : INFINITY;
        const SampleCounts found = place_samples<MAY_BE_HIDDEN>(chunk, filled, level);
        if (found.here > 0) {
            if constexpr (MAY_BE_HIDDEN) {
                leave_out_hidden(DepthMap(photos, photo, sizes + 2 * number), chunk, filled);
            }
            const auto start =
                static_cast<std::size_t>(photos.level_start[photos.levels * photo + number]);
            add_samples(chunk, count, photos.texels + 4 * start,
                        static_cast<std::size_t>(level.width), image);
        }
        if (found.elsewhere == 0) {
            break;
        }
    }
}

}  // namespace lfnav::LFNAV_LEVEL
