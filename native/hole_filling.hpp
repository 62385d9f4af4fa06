// Pixels that none of the photos of their tile shows: which other photo does.
//
// Most such pixels are shown by no photo at all. So photos are ruled out for whole regions first:
// the surface points of a rectangle of pixels are within a box of columns, rows and inverse depths,
// and places in a photo are linear in these; where all corners of the box are beyond the same
// border of a photo, everything between them is.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "homography.hpp"
#include "light_field.hpp"
#include "occlusion.hpp"
#include "surface.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Around some pixels.
struct PixelBox {
    static constexpr double LARGEST = std::numeric_limits<double>::infinity();
    double x[2] = {LARGEST, -LARGEST}, y[2] = {LARGEST, -LARGEST}, d[2] = {LARGEST, -LARGEST};

    void add(float own_x, float own_y, float inverse_depth) {
        const auto grow = [](double* range, float value) {
            range[0] = std::min(range[0], static_cast<double>(value));
            range[1] = std::max(range[1], static_cast<double>(value));
        };
        grow(x, own_x);
        grow(y, own_y);
        grow(d, inverse_depth);
    }

    bool is_empty() const { return x[0] > x[1]; }
};

/// Whether a photo may show a point of a box: whether there is one before the photo's camera, and
/// one on the inner side of each border of its image.
inline bool may_show(const Photos& photos, std::size_t photo, const Homography& homography,
                     const PixelBox& box) {
    const std::int64_t* const size = photos.size_of(photo);
    const auto& map = homography.map;
    const auto& shift = homography.shift;
    // How far at most points are on the inner side, for distances that are linear in places in the
    // photo: those to borders are sign times row i of the homography plus margin times the depth.
    const auto largest = [&](std::size_t i, double sign, double margin) {
        const auto most = [](double factor, const double* range) {
            return std::max(factor * range[0], factor * range[1]);
        };
        return most(sign * map[3 * i] + margin * map[6], box.x) +
               most(sign * map[3 * i + 1] + margin * map[7], box.y) +
               (sign * map[3 * i + 2] + margin * map[8]) +
               most(sign * shift[i] + margin * shift[2], box.d);
    };
    const double right = static_cast<double>(size[0]) - 0.5;
    const double bottom = static_cast<double>(size[1]) - 0.5;
    return largest(2, 1.0, 0.0) > 0.0 && largest(0, 1.0, 0.5) >= 0.0 &&
           largest(0, -1.0, right) >= 0.0 && largest(1, 1.0, 0.5) >= 0.0 &&
           largest(1, -1.0, bottom) >= 0.0;
}

/// Finds the photos for pixels; memory of it is used again.
class HoleFilling {
  public:
    /// Of a pixel that a photo shows: which they are.
    struct Found {
        std::size_t pixel, photo;
    };

    /// Finds for each uncovered pixel the photo with the nearest projected centre that shows it.
    ///
    /// @param usable: (N,) which photos may.
    /// @param homographies: for the camera.
    /// @param pixels: of the image that is made, row by row, with
    /// @param inverse_depths: of the surface.
    /// @param image: (P, 4) where the last number is 0, the pixel is not covered.
    std::span<const Found> operator()(const Photos& photos, const bool* usable,
                                      const VirtualCamera& camera, Homographies& homographies,
                                      const ImagePoints& pixels,
                                      std::span<const float> inverse_depths, const float* image) {
        found_.clear();
        candidates_.clear();
        const auto is_hole = [&](std::size_t i) {
            return image[4 * i + 3] == 0.0F && inverse_depths[i] > 0.0F;
        };
        PixelBox all;
        for (std::size_t i = 0; i < inverse_depths.size(); ++i) {
            if (is_hole(i)) {
                all.add(pixels.x[i], pixels.y[i], inverse_depths[i]);
            }
        }
        if (all.is_empty()) {
            return {};
        }
        for (std::size_t photo = 0; photo < photos.count; ++photo) {
            if (usable[photo] && may_show(photos, photo, homographies[photo], all)) {
                candidates_.push_back(
                    {photo, projected_centre(photos.centres + 3 * photo, camera)});
            }
        }
        std::size_t last = 0;
        while (last < inverse_depths.size() && !candidates_.empty()) {
            const std::size_t first = last;
            PixelBox box;
            for (; last < inverse_depths.size() && pixels.y[last] == pixels.y[first]; ++last) {
                if (is_hole(last)) {
                    box.add(pixels.x[last], pixels.y[last], inverse_depths[last]);
                }
            }
            if (box.is_empty()) {
                continue;
            }
            in_row_.clear();
            for (const Candidate& one : candidates_) {
                if (may_show(photos, one.photo, homographies[one.photo], box)) {
                    in_row_.push_back(one);
                }
            }
            for (std::size_t i = first; i < last && !in_row_.empty(); ++i) {
                if (is_hole(i)) {
                    find(photos, homographies, pixels.x[i], pixels.y[i], inverse_depths[i], i);
                }
            }
        }
        return found_;
    }

  private:
    struct Candidate {
        std::size_t photo;
        Point centre;
    };

    /// One that has something nearer before the pixel's surface point is taken only where all have:
    /// depth maps are not exact enough to leave holes.
    void find(const Photos& photos, Homographies& homographies, double x, double y,
              double inverse_depth, std::size_t number) {
        // Of those that do not have, and of those that have.
        double shortest[2] = {PixelBox::LARGEST, PixelBox::LARGEST};
        std::size_t nearest[2] = {photos.count, photos.count};
        for (const Candidate& one : in_row_) {
            const double across = one.centre.x - x, down = one.centre.y - y;
            const double distance = across * across + down * down;
            if (distance >= shortest[0]) {
                continue;
            }
            const Place place = homographies[one.photo].locate(x, y, inverse_depth);
            if (place.depth <= 0.0 || !is_inside(photos, one.photo, place)) {
                continue;
            }
            const DepthMap map(photos, one.photo, photos.size_of(one.photo));
            const bool is_hidden =
                map.hides(static_cast<float>(place.u), static_cast<float>(place.v),
                          static_cast<float>(inverse_depth / place.depth));
            if (distance < shortest[is_hidden]) {
                shortest[is_hidden] = distance;
                nearest[is_hidden] = one.photo;
            }
        }
        const std::size_t best = nearest[nearest[0] == photos.count];
        if (best < photos.count) {
            found_.push_back({number, best});
        }
    }

    std::vector<Found> found_;
    std::vector<Candidate> candidates_, in_row_;
};

}  // namespace lfnav::LFNAV_LEVEL
