// The normal equations of direct image alignment, of one rendered view and one camera image.

#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <span>
#include <vector>

#include "image.hpp"
#include "level.hpp"
#include "robust_error.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Focal lengths and principal point, pixels.
struct Pinhole {
    double fx, fy, cx, cy;
};

/// How surface points move against the camera, in its axes, when an unknown grows by a unit: seen
/// on the ray r at inverse depth d, by -(rotation x r + d translation), times their depth.
struct Motion {
    std::array<double, 3> rotation, translation;
};

/// Motions of surface points against the camera.
///
/// A point at offset Y from the camera's centre, in its axes, moves by -R^T (dp + w x (X - p)) when
/// the body at p is shifted by dp and rotated by w; divided by its depth this stays finite for
/// points far away.
///
/// @param rotation: (3, 3) R of world_from_camera.
/// @param lever: (3,) from the body's origin to the camera's centre, world axes.
/// @param axes: (D, 3) world axis of each unknown.
/// @param is_rotation: (D,) whether the unknown is a rotation about its axis, or a shift along it.
inline std::vector<Motion> camera_motions(std::span<const double> rotation,
                                          std::span<const double> lever,
                                          std::span<const double> axes,
                                          std::span<const bool> is_rotation) {
    std::vector<Motion> motions(is_rotation.size());
    for (std::size_t k = 0; k < motions.size(); ++k) {
        const double* const axis = &axes[3 * k];
        for (std::size_t i = 0; i < 3; ++i) {
            double own = 0.0, arm = 0.0;
            for (std::size_t j = 0; j < 3; ++j) {
                own += rotation[3 * j + i] * axis[j];
                // The cross product of axis and lever.
                const std::size_t p = (j + 1) % 3, q = (j + 2) % 3;
                arm += rotation[3 * j + i] * (axis[p] * lever[q] - axis[q] * lever[p]);
            }
            motions[k].rotation[i] = is_rotation[k] ? own : 0.0;
            motions[k].translation[i] = is_rotation[k] ? arm : own;
        }
    }
    return motions;
}

/// More unknowns than these no pose has.
constexpr std::size_t MOST_UNKNOWNS = 6;

/// A view as the normal equations see it.
struct AlignedView {
    /// Rendered, and 1 where covered.
    MaskedImage image;
    /// Of the surface.
    ScalarImage inverse_depth;
    /// Camera image, and 1 where it is to be compared.
    MaskedImage target;
    Photometry photometry;
    /// Neighbours that differ by less grey levels say nothing about the pose.
    double flat;
    Pinhole pinhole;
};

// A row's pixels are worked on so many at a time: what is kept of them stays in the nearest memory.
constexpr std::size_t CHUNK = 64;
// Sums are kept apart in so many lanes, whatever the processor's registers hold: all pixels of a
// chunk that are so far from each other share one. Numbers of pixels are rounded up to this.
constexpr std::size_t LANES = 8;
// Floats before the first pixel of a row of planes and behind the last: zeros, so uncovered.
constexpr std::size_t MARGIN = 16;

/// Rows of an image, channel by channel, zeros beyond their ends.
class Planes {
  public:
    Planes(std::size_t width, std::size_t rows)
        : stride_(width + 2 * MARGIN + LANES), rows_(rows), values_(4 * rows * stride_) {}

    /// Where the first pixel of a channel of a row is; rows are used again after so many others.
    float* channel(std::size_t row, std::size_t channel) {
        return values_.data() + (4 * (row % rows_) + channel) * stride_ + MARGIN;
    }

  private:
    std::size_t stride_, rows_;
    std::vector<float> values_;
};

LFNAV_INLINE void set_row(const MaskedImage& image, std::size_t y, Planes& planes) {
    const float* const __restrict pixels = image.row(y);
    float* const __restrict r = planes.channel(y, 0), * const __restrict g = planes.channel(y, 1);
    float* const __restrict b = planes.channel(y, 2), * const __restrict a = planes.channel(y, 3);
    for (std::size_t x = 0; x < image.width; ++x) {
        r[x] = pixels[4 * x];
        g[x] = pixels[4 * x + 1];
        b[x] = pixels[4 * x + 2];
        a[x] = pixels[4 * x + 3];
    }
}

/// Weighted sums over the channels of the pixels of a chunk; zeros where one says nothing.
///
/// With slopes g and h across and down, error e, value v and weight w, they are those of the
/// products in their names.
struct PixelSums {
    double gg[CHUNK], gh[CHUNK], hh[CHUNK], ge[CHUNK], he[CHUNK], gv[CHUNK], hv[CHUNK], g[CHUNK],
        h[CHUNK], ve[CHUNK], e[CHUNK], vv[CHUNK], v[CHUNK], w[CHUNK];
};

/// How an unknown moves the pixels of a chunk, across and down, and these times the pixel's matrix
/// of slopes.
struct PixelMotion {
    double across[CHUNK], down[CHUNK], slope_across[CHUNK], slope_down[CHUNK];
};

/// Where the pixels of a chunk are in the planes of three rows of the view and one of the target.
struct ChunkRows {
    const float *above[4], *row[4], *below[4], *target[4];
};

LFNAV_INLINE void set_sums(const ChunkRows& rows, std::size_t count, const Photometry& photometry,
                           float flat, PixelSums& sums) {
    const double gain = photometry.gain, offset = photometry.offset;
    const double inverse_limit = 1.0 / photometry.limit, half_gain = 0.5 * gain;
#pragma omp simd
    for (std::size_t x = 0; x < count; ++x) {
        double gg = 0.0, gh = 0.0, hh = 0.0, ge = 0.0, he = 0.0, gv = 0.0, hv = 0.0;
        double g1 = 0.0, h1 = 0.0, ve = 0.0, e1 = 0.0, vv = 0.0, v1 = 0.0, w1 = 0.0;
        float steepest = 0.0F;
        const auto add = [&](const float* above, const float* row, const float* below,
                             const float* target) __attribute__((always_inline)) {
            const float across = row[x + 1] - row[x - 1], down = below[x] - above[x];
            const float steep = std::max(std::abs(across), std::abs(down));
            steepest = std::max(steepest, steep);
            const double value = static_cast<double>(row[x]);
            const double error = gain * value + offset - static_cast<double>(target[x]);
            const double ratio = error * inverse_limit, rest = 1.0 - ratio * ratio;
            const double inside = rest > 0.0 ? rest : 0.0;
            const double weight = inside * inside;
            const double g = half_gain * static_cast<double>(across);
            const double h = half_gain * static_cast<double>(down);
            const double wg = weight * g, wh = weight * h, wv = weight * value;
            gg += wg * g;
            gh += wg * h;
            hh += wh * h;
            ge += wg * error;
            he += wh * error;
            gv += wg * value;
            hv += wh * value;
            g1 += wg;
            h1 += wh;
            ve += wv * error;
            e1 += weight * error;
            vv += wv * value;
            v1 += wv;
            w1 += weight;
        };
        add(rows.above[0], rows.row[0], rows.below[0], rows.target[0]);
        add(rows.above[1], rows.row[1], rows.below[1], rows.target[1]);
        add(rows.above[2], rows.row[2], rows.below[2], rows.target[2]);
        const float* const covered = rows.row[3] + x;
        const float around = rows.above[3][x] * rows.below[3][x] * covered[-1] * covered[1];
        const float seen = around * *covered * rows.target[3][x];
        // Chosen and not multiplied: what an uncovered pixel holds may be no number.
        const bool counts = seen > 0.0F && steepest >= flat;
        const double used = static_cast<double>(seen);
        sums.gg[x] = counts ? used * gg : 0.0;
        sums.gh[x] = counts ? used * gh : 0.0;
        sums.hh[x] = counts ? used * hh : 0.0;
        sums.ge[x] = counts ? used * ge : 0.0;
        sums.he[x] = counts ? used * he : 0.0;
        sums.gv[x] = counts ? used * gv : 0.0;
        sums.hv[x] = counts ? used * hv : 0.0;
        sums.g[x] = counts ? used * g1 : 0.0;
        sums.h[x] = counts ? used * h1 : 0.0;
        sums.ve[x] = counts ? used * ve : 0.0;
        sums.e[x] = counts ? used * e1 : 0.0;
        sums.vv[x] = counts ? used * vv : 0.0;
        sums.v[x] = counts ? used * v1 : 0.0;
        sums.w[x] = counts ? used * w1 : 0.0;
    }
}

/// Inverse depths of the pixels that count, and zeros: what others hold may be no number.
LFNAV_INLINE void set_inverse_depth(const double* own, const PixelSums& sums, std::size_t count,
                                    double* inverse_depth) {
#pragma omp simd
    for (std::size_t x = 0; x < count; ++x) {
        inverse_depth[x] = sums.w[x] > 0.0 ? own[x] : 0.0;
    }
}

LFNAV_INLINE void set_motion(const Motion& motion, const double* inverse_depth, const double* ray,
                             double ray_y, const Pinhole& pinhole, std::size_t count,
                             const PixelSums& sums, PixelMotion& moves) {
    // No structured bindings: clang takes none into a loop of OpenMP.
    const double wx = motion.rotation[0], wy = motion.rotation[1], wz = motion.rotation[2];
    const double tx = motion.translation[0], ty = motion.translation[1], tz = motion.translation[2];
    const double fx = pinhole.fx, fy = pinhole.fy;
#pragma omp simd
    for (std::size_t x = 0; x < count; ++x) {
        const double near = inverse_depth[x];
        const double depth_step = wx * ray_y - wy * ray[x] + near * tz;
        const double across = fx * (wy - wz * ray_y + near * tx - ray[x] * depth_step);
        const double down = fy * (wz * ray[x] - wx + near * ty - ray_y * depth_step);
        moves.across[x] = across;
        moves.down[x] = down;
        moves.slope_across[x] = sums.gg[x] * across + sums.gh[x] * down;
        moves.slope_down[x] = sums.gh[x] * across + sums.hh[x] * down;
    }
}

/// Sums of terms of pixels, kept apart lane by lane; and the upper triangle of a Hessian of them.
using SumLanes = std::array<double, LANES>;
using HessianLanes = SumLanes[MOST_UNKNOWNS + 2][MOST_UNKNOWNS + 2];

/// Adds a term of each pixel of a chunk.
///
/// @param term: gives those of the pixels from one on, a vector of doubles.
template <typename Term>
LFNAV_INLINE void add_terms(std::size_t count, SumLanes& lanes, Term term) {
    using Vector = DoubleVector;
    constexpr std::size_t DOUBLES = BYTES / sizeof(double), VECTORS = LANES / DOUBLES;
    Vector sums[VECTORS] = {};
    for (std::size_t x = 0; x < count; x += LANES) {
        for (std::size_t k = 0; k < VECTORS; ++k) {
            sums[k] += term(x + k * DOUBLES);
        }
    }
    for (std::size_t k = 0; k < VECTORS; ++k) {
        double* const own = lanes.data() + k * DOUBLES;
        const Vector sum = loaded<Vector>(own) + sums[k];
        store(sum, own);
    }
}

LFNAV_INLINE void add_hessian(const PixelSums& sums, const PixelMotion* moves, std::size_t unknowns,
                              std::size_t count, HessianLanes& hessian) {
    using Vector = DoubleVector;
    const auto products = [](const double* a, const double* b, const double* c, const double* d) {
        return [=](std::size_t i) __attribute__((always_inline)) {
            return loaded<Vector>(a + i) * loaded<Vector>(b + i) +
                   loaded<Vector>(c + i) * loaded<Vector>(d + i);
        };
    };
    const auto numbers = [](const double* a) {
        return [=](std::size_t i) __attribute__((always_inline)) { return loaded<Vector>(a + i); };
    };
    for (std::size_t k = 0; k < unknowns; ++k) {
        const PixelMotion& own = moves[k];
        for (std::size_t j = k; j < unknowns; ++j) {
            add_terms(count, hessian[k][j],
                      products(own.slope_across, moves[j].across, own.slope_down, moves[j].down));
        }
        add_terms(count, hessian[k][unknowns], products(sums.gv, own.across, sums.hv, own.down));
        add_terms(count, hessian[k][unknowns + 1], products(sums.g, own.across, sums.h, own.down));
    }
    add_terms(count, hessian[unknowns][unknowns], numbers(sums.vv));
    add_terms(count, hessian[unknowns][unknowns + 1], numbers(sums.v));
    add_terms(count, hessian[unknowns + 1][unknowns + 1], numbers(sums.w));
}

/// Adds to the gradients of columns of a chunk, which belong to one row of tiles.
///
/// @param columns: (D + 2, stride), at the first column of the chunk.
LFNAV_INLINE void add_gradients(const PixelSums& sums, const PixelMotion* moves,
                                std::size_t unknowns, std::size_t count, std::size_t stride,
                                double* columns) {
    for (std::size_t k = 0; k < unknowns; ++k) {
        double* const own = columns + k * stride;
        const PixelMotion& motion = moves[k];
#pragma omp simd
        for (std::size_t x = 0; x < count; ++x) {
            own[x] += sums.ge[x] * motion.across[x] + sums.he[x] * motion.down[x];
        }
    }
    double *const gain = columns + unknowns * stride, *const offset = gain + stride;
#pragma omp simd
    for (std::size_t x = 0; x < count; ++x) {
        gain[x] += sums.ve[x];
        offset[x] += sums.e[x];
    }
}

/// Adds the gradients of columns to those of their tiles, and sets them back to zero.
inline void add_columns(std::span<double> columns, std::size_t width, std::size_t stride,
                        std::size_t tiles_across, double* tile_gradients) {
    const std::size_t numbers = columns.size() / stride;
    for (std::size_t k = 0; k < numbers; ++k) {
        for (std::size_t x = 0; x < width; ++x) {
            tile_gradients[x * tiles_across / width * numbers + k] += columns[k * stride + x];
        }
    }
    std::fill(columns.begin(), columns.end(), 0.0);
}

LFNAV_INLINE void add_up(const AlignedView& view, std::span<const Motion> motions,
                         std::size_t tiles_across, HessianLanes& hessian,
                         std::span<double> tile_gradients) {
    const std::size_t width = view.image.width, height = view.image.height;
    const std::size_t unknowns = motions.size(), stride = width + CHUNK;
    const auto flat = static_cast<float>(view.flat);
    Planes image(width, 3), target(width, 1);
    std::vector<double> ray(stride), inverse_depth(stride), columns((unknowns + 2) * stride);
    for (std::size_t x = 0; x < width; ++x) {
        ray[x] = (static_cast<double>(x) - view.pinhole.cx) / view.pinhole.fx;
    }
    PixelSums sums;
    PixelMotion moves[MOST_UNKNOWNS];
    double near[CHUNK];
    set_row(view.image, 0, image);
    set_row(view.image, 1, image);
    for (std::size_t y = 1; y + 1 < height; ++y) {
        set_row(view.image, y + 1, image);
        // One row of the target: all of them are row 0 of its planes.
        set_row(view.target, y, target);
        for (std::size_t x = 0; x < width; ++x) {
            inverse_depth[x] = static_cast<double>(view.inverse_depth.row(y)[x]);
        }
        const double ray_y = (static_cast<double>(y) - view.pinhole.cy) / view.pinhole.fy;
        for (std::size_t first = 0; first < width; first += CHUNK) {
            const std::size_t left = std::min(CHUNK, width - first);
            const std::size_t count = (left + LANES - 1) / LANES * LANES;
            ChunkRows rows;
            for (std::size_t channel = 0; channel < 4; ++channel) {
                rows.above[channel] = image.channel(y - 1, channel) + first;
                rows.row[channel] = image.channel(y, channel) + first;
                rows.below[channel] = image.channel(y + 1, channel) + first;
                rows.target[channel] = target.channel(y, channel) + first;
            }
            set_sums(rows, count, view.photometry, flat, sums);
            set_inverse_depth(inverse_depth.data() + first, sums, count, near);
            for (std::size_t k = 0; k < unknowns; ++k) {
                set_motion(motions[k], near, ray.data() + first, ray_y, view.pinhole, count, sums,
                           moves[k]);
            }
            add_hessian(sums, moves, unknowns, count, hessian);
            add_gradients(sums, moves, unknowns, count, stride, columns.data() + first);
        }
        const std::size_t tile_row = y * tiles_across / height;
        if (y + 2 == height || (y + 1) * tiles_across / height != tile_row) {
            add_columns(columns, width, stride, tiles_across,
                        tile_gradients.data() + tile_row * tiles_across * (unknowns + 2));
        }
    }
}

/// The weighted normal equations of one comparison; gain and offset are two unknowns more.
///
/// The colour of a surface point is taken to move along with it. A pixel counts where it and its
/// four neighbours are covered.
///
/// @param motions: of the D unknowns of the pose, at most MOST_UNKNOWNS.
/// @param tiles_across: the gradients of so many times so many tiles of the image are kept apart.
/// @param hessian: (D + 2, D + 2) zeros, receives the sum.
/// @param tile_gradients: (tiles, D + 2) zeros, receives the gradient of each tile.
inline void add_normal_equations(const AlignedView& view, std::span<const Motion> motions,
                                 std::size_t tiles_across, std::span<double> hessian,
                                 std::span<double> tile_gradients) {
    if (view.image.height < 3 || view.image.width < 3) {
        return;
    }
    HessianLanes lanes = {};
    add_up(view, motions, tiles_across, lanes, tile_gradients);
    const std::size_t size = motions.size() + 2;
    for (std::size_t k = 0; k < size; ++k) {
        for (std::size_t j = k; j < size; ++j) {
            double sum = 0.0;
            for (const double lane : lanes[k][j]) {
                sum += lane;
            }
            hessian[k * size + j] += sum;
            if (j != k) {
                hessian[j * size + k] += sum;
            }
        }
    }
}

}  // namespace lfnav::LFNAV_LEVEL
