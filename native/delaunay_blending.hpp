// Blending by the Delaunay mesh of those photos that see anything of what the virtual camera sees.

#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "delaunay_mesh.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "light_field.hpp"
#include "plane_views.hpp"
#include "regions.hpp"

namespace lfnav::LFNAV_LEVEL {

class DelaunayBlending {
  public:
    DelaunayBlending(const PlaneScene& scene, const VirtualViews& views, const Middle& middle)
        : photos_(scene.photos),
          takes_part_(std::make_unique<bool[]>(scene.photos.count)),
          mesh_(scene.mesh, views.width, views.height, views.pixels, middle) {
        for (const std::int64_t y : views.grid.frustum_down) {
            for (const std::int64_t x : views.grid.frustum_across) {
                columns_.push_back(static_cast<double>(x));
                rows_.push_back(static_cast<double>(y));
            }
        }
        depths_.resize(columns_.size());
    }

    std::span<const Region> regions() const { return mesh_.regions(); }
    const RegionPixels& pixels() const { return mesh_.pixels(); }
    /// (N,) photos that may show what those of a region do not.
    const bool* candidates() const { return takes_part_.get(); }

    /// Makes the mesh for a virtual camera.
    ///
    /// @param homography: makes that of a photo, or has it.
    template <typename HomographyOf>
    LFNAV_INLINE void choose(const VirtualCamera& camera, HomographyOf homography) {
        for (std::size_t i = 0; i < depths_.size(); ++i) {
            depths_[i] = static_cast<double>(camera.inverse_depth(columns_[i], rows_[i]));
        }
        for (std::size_t photo = 0; photo < photos_.count; ++photo) {
            takes_part_[photo] = photos_.usable[photo] && sees_any(photo, homography(photo));
        }
        mesh_.build(camera, photos_.centres, takes_part_.get(), photos_.count);
    }

  private:
    /// Whether a photo sees any of the surface points that stand for the virtual frustum.
    LFNAV_INLINE bool sees_any(std::size_t photo, const Homography& homography) const {
        const std::int64_t* const size = photos_.level_size + 2 * photos_.levels * photo;
        const double right = static_cast<double>(size[0]) - 0.5;
        const double bottom = static_cast<double>(size[1]) - 0.5;
        const auto& map = homography.map;
        const double u0 = map[0], u1 = map[1], u2 = map[2], u3 = homography.shift[0];
        const double v0 = map[3], v1 = map[4], v2 = map[5], v3 = homography.shift[1];
        const double w0 = map[6], w1 = map[7], w2 = map[8], w3 = homography.shift[2];
        std::int32_t seen = 0;
#pragma omp simd reduction(+ : seen)
        for (std::size_t i = 0; i < depths_.size(); ++i) {
            const double x = columns_[i], y = rows_[i], d = depths_[i];
            const double u = u0 * x + u1 * y + u2 + u3 * d, v = v0 * x + v1 * y + v2 + v3 * d;
            const double w = w0 * x + w1 * y + w2 + w3 * d;
            const bool is_seen = (d > 0.0) & (w > 0.0) & (u >= -0.5 * w) & (u <= right * w) &
                                 (v >= -0.5 * w) & (v <= bottom * w);
            seen += is_seen ? 1 : 0;
        }
        return seen > 0;
    }

    Photos photos_;
    std::unique_ptr<bool[]> takes_part_;
    /// Surface points: columns, rows and inverse depths.
    std::vector<double> columns_, rows_, depths_;
    DelaunayMesh mesh_;
};

}  // namespace lfnav::LFNAV_LEVEL
