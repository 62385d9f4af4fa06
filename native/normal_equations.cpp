#include "normal_equations.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

#include "level.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

namespace {

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

LFNAV_INLINE void set_planes(const float* __restrict pixels, std::size_t width, float* __restrict r,
                             float* __restrict g, float* __restrict b, float* __restrict a) {
    for (std::size_t x = 0; x < width; ++x) {
        r[x] = pixels[4 * x];
        g[x] = pixels[4 * x + 1];
        b[x] = pixels[4 * x + 2];
        a[x] = pixels[4 * x + 3];
    }
}

LFNAV_INLINE void set_row(const MaskedImage& image, std::size_t y, Planes& planes) {
    set_planes(image.row(y), image.width, planes.channel(y, 0), planes.channel(y, 1),
               planes.channel(y, 2), planes.channel(y, 3));
}

/// Weighted sums over the channels of the pixels of a chunk; zeros where one says nothing.
///
/// With slopes g and h across and down, error e, value v and weight w, they are those of the
/// products in their names.
struct ChannelSums {
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
                           float flat, ChannelSums& sums) {
    const double gain = photometry.gain, offset = photometry.offset;
    const double inverse_limit = 1.0 / photometry.limit, half_gain = 0.5 * gain;
    const float *covered_above = rows.above[3], *covered = rows.row[3],
                *covered_below = rows.below[3];
    const float* compared = rows.target[3];
    const float *above0 = rows.above[0], *row0 = rows.row[0], *below0 = rows.below[0];
    const float *above1 = rows.above[1], *row1 = rows.row[1], *below1 = rows.below[1];
    const float *above2 = rows.above[2], *row2 = rows.row[2], *below2 = rows.below[2];
    const float *target0 = rows.target[0], *target1 = rows.target[1], *target2 = rows.target[2];
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
        add(above0, row0, below0, target0);
        add(above1, row1, below1, target1);
        add(above2, row2, below2, target2);
        const float around = covered_above[x] * covered_below[x] * covered[x - 1] * covered[x + 1];
        const float seen = around * covered[x] * compared[x];
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
LFNAV_INLINE void set_inverse_depth(const double* own, const ChannelSums& sums, std::size_t count,
                                    double* inverse_depth) {
#pragma omp simd
    for (std::size_t x = 0; x < count; ++x) {
        inverse_depth[x] = sums.w[x] > 0.0 ? own[x] : 0.0;
    }
}

LFNAV_INLINE void set_motion(const Motion& motion, const double* inverse_depth, const double* ray,
                             double ray_y, const Pinhole& pinhole, std::size_t count,
                             const ChannelSums& sums, PixelMotion& moves) {
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

using Lanes = std::array<double, LANES>;

/// Sums of terms of the pixels of a chunk, lane by lane, in registers.
struct LaneSums {
    using Vector = DoubleVector;
    static constexpr std::size_t DOUBLES = BYTES / sizeof(double);
    static constexpr std::size_t VECTORS = LANES / DOUBLES;

    /// Adds the products of two pairs of numbers of each pixel.
    LFNAV_INLINE static void add_products(const double* a, const double* b, const double* c,
                                          const double* d, std::size_t count, Lanes& lanes) {
        Vector sums[VECTORS] = {};
        for (std::size_t x = 0; x < count; x += LANES) {
            for (std::size_t k = 0; k < VECTORS; ++k) {
                const std::size_t i = x + k * DOUBLES;
                sums[k] += loaded<Vector>(a + i) * loaded<Vector>(b + i) +
                           loaded<Vector>(c + i) * loaded<Vector>(d + i);
            }
        }
        add(sums, lanes);
    }

    /// Adds a number of each pixel.
    LFNAV_INLINE static void add_numbers(const double* a, std::size_t count, Lanes& lanes) {
        Vector sums[VECTORS] = {};
        for (std::size_t x = 0; x < count; x += LANES) {
            for (std::size_t k = 0; k < VECTORS; ++k) {
                sums[k] += loaded<Vector>(a + x + k * DOUBLES);
            }
        }
        add(sums, lanes);
    }

  private:
    LFNAV_INLINE static void add(const Vector* sums, Lanes& lanes) {
        for (std::size_t k = 0; k < VECTORS; ++k) {
            double* const own = lanes.data() + k * DOUBLES;
            const Vector sum = loaded<Vector>(own) + sums[k];
            store(sum, own);
        }
    }
};

/// The upper triangle of a Hessian, in lanes.
struct HessianLanes {
    Lanes sums[MOST_UNKNOWNS + 2][MOST_UNKNOWNS + 2] = {};
};

LFNAV_INLINE void add_hessian(const ChannelSums& sums, const PixelMotion* moves,
                              std::size_t unknowns, std::size_t count, HessianLanes& hessian) {
    using Sums = LaneSums;
    auto& h = hessian.sums;
    for (std::size_t k = 0; k < unknowns; ++k) {
        const PixelMotion& own = moves[k];
        for (std::size_t j = k; j < unknowns; ++j) {
            Sums::add_products(own.slope_across, moves[j].across, own.slope_down, moves[j].down,
                               count, h[k][j]);
        }
        Sums::add_products(sums.gv, own.across, sums.hv, own.down, count, h[k][unknowns]);
        Sums::add_products(sums.g, own.across, sums.h, own.down, count, h[k][unknowns + 1]);
    }
    Sums::add_numbers(sums.vv, count, h[unknowns][unknowns]);
    Sums::add_numbers(sums.v, count, h[unknowns][unknowns + 1]);
    Sums::add_numbers(sums.w, count, h[unknowns + 1][unknowns + 1]);
}

/// Adds to the gradients of columns of a chunk, which belong to one row of tiles.
///
/// @param columns: (D + 2, stride), at the first column of the chunk.
LFNAV_INLINE void add_gradients(const ChannelSums& sums, const PixelMotion* moves,
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
void add_columns(std::span<double> columns, std::size_t width, std::size_t stride,
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
    ChannelSums sums;
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

}  // namespace

void add_normal_equations(const AlignedView& view, std::span<const Motion> motions,
                          std::size_t tiles_across, std::span<double> hessian,
                          std::span<double> tile_gradients) {
    if (view.image.height < 3 || view.image.width < 3) {
        return;
    }
    HessianLanes lanes;
    add_up(view, motions, tiles_across, lanes, tile_gradients);
    const std::size_t size = motions.size() + 2;
    for (std::size_t k = 0; k < size; ++k) {
        for (std::size_t j = k; j < size; ++j) {
            double sum = 0.0;
            for (const double lane : lanes.sums[k][j]) {
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
