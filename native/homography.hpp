// From virtual pixels to world directions, and into photos.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "level.hpp"
#include "light_field.hpp"

namespace lfnav::LFNAV_LEVEL {

struct VirtualCamera {
    /// (4, 4) world_from_camera.
    const double* pose;
    double fx, fy, cx, cy;
    /// (3, 3) virtual pixels to world directions whose length along the optical axis is 1.
    double rays[9];

    VirtualCamera(const double* world_from_camera, const double* intrinsics)
        : pose(world_from_camera),
          fx(intrinsics[0]),
          fy(intrinsics[1]),
          cx(intrinsics[2]),
          cy(intrinsics[3]) {
        for (std::size_t i = 0; i < 3; ++i) {
            const double x = pose[4 * i] / fx, y = pose[4 * i + 1] / fy;
            rays[3 * i] = x;
            rays[3 * i + 1] = y;
            rays[3 * i + 2] = pose[4 * i + 2] - x * cx - y * cy;
        }
    }

    double focal() const { return 0.5 * (fx + fy); }
};

struct Point {
    double x, y;
};

/// Where a recording centre projects to in the virtual image, whichever side of it it is on.
inline Point projected_centre(const double* centre, const VirtualCamera& camera) {
    // Relative to its distance a centre is at least this deep: projections stay finite.
    constexpr double SMALLEST_DEPTH = 1e-7;
    double own[3] = {};
    for (std::size_t i = 0; i < 3; ++i) {
        const double offset = centre[i] - camera.pose[4 * i + 3];
        for (std::size_t j = 0; j < 3; ++j) {
            own[j] += camera.pose[4 * i + j] * offset;
        }
    }
    const double smallest = std::max(
        SMALLEST_DEPTH * std::sqrt(own[0] * own[0] + own[1] * own[1] + own[2] * own[2]), 1e-300);
    const double depth = std::abs(own[2]) < smallest ? smallest : own[2];
    return {camera.fx * own[0] / depth + camera.cx, camera.fy * own[1] / depth + camera.cy};
}

/// A place in a photo, and the depth of what is there, relative to the virtual one.
struct Place {
    double u, v, depth;
};

/// Where columns and rows count from in single precision, the middle of the virtual image: near it
/// numbers are small. The same for all pixels, so that what one shows does not depend on which
/// others are rendered.
struct Middle {
    std::int32_t x, y;
};

/// Into a photo: the virtual pixel p at inverse depth d is at map p + shift d.
struct Homography {
    double map[9], shift[3];
    /// For columns and rows from the middle: coefficients of x, y, 1 and d.
    float rows[3][4];

    void set(const Photos& photos, std::size_t photo, const VirtualCamera& camera,
             const Middle& middle) {
        const double* const projection = photos.projection + 12 * photo;
        for (std::size_t i = 0; i < 3; ++i) {
            const double* const row = projection + 4 * i;
            shift[i] = row[3];
            for (std::size_t j = 0; j < 3; ++j) {
                shift[i] += row[j] * camera.pose[4 * j + 3];
                map[3 * i + j] = row[0] * camera.rays[j] + row[1] * camera.rays[3 + j] +
                                 row[2] * camera.rays[6 + j];
            }
            const double* const own = map + 3 * i;
            rows[i][0] = static_cast<float>(own[0]);
            rows[i][1] = static_cast<float>(own[1]);
            rows[i][2] = static_cast<float>(own[0] * middle.x + own[1] * middle.y + own[2]);
            rows[i][3] = static_cast<float>(shift[i]);
        }
    }

    double row(std::size_t i, double x, double y, double d) const {
        return map[3 * i] * x + map[3 * i + 1] * y + map[3 * i + 2] + shift[i] * d;
    }

    /// The depth is 0 for points behind the photo's camera.
    Place locate(double x, double y, double inverse_depth) const {
        const double depth = row(2, x, y, inverse_depth);
        if (!(depth > 0.0)) {
            return {0.0, 0.0, 0.0};
        }
        return {row(0, x, y, inverse_depth) / depth, row(1, x, y, inverse_depth) / depth, depth};
    }
};

/// The homographies into all photos for one virtual camera after the other, each made when it is
/// asked for first.
class Homographies {
  public:
    Homographies(const Photos& photos, const Middle& middle)
        : photos_(photos), middle_(middle), all_(photos.count), is_made_(photos.count) {}

    /// @param camera: has to stay as long as homographies are asked for.
    void begin(const VirtualCamera& camera) {
        camera_ = &camera;
        std::fill(is_made_.begin(), is_made_.end(), std::uint8_t{0});
    }

    LFNAV_INLINE const Homography& operator[](std::size_t photo) {
        if (is_made_[photo] == 0) {
            all_[photo].set(photos_, photo, *camera_, middle_);
            is_made_[photo] = 1;
        }
        return all_[photo];
    }

  private:
    Photos photos_;
    Middle middle_;
    const VirtualCamera* camera_ = nullptr;
    std::vector<Homography> all_;
    std::vector<std::uint8_t> is_made_;
};

/// Whether a place is inside a photo's image.
inline bool is_inside(const Photos& photos, std::size_t photo, const Place& place) {
    const std::int64_t* const size = photos.size_of(photo);
    return place.u >= -0.5 && place.u <= static_cast<double>(size[0]) - 0.5 && place.v >= -0.5 &&
           place.v <= static_cast<double>(size[1]) - 0.5;
}

}  // namespace lfnav::LFNAV_LEVEL
