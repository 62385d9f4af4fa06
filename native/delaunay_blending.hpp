// Blending by the Delaunay mesh of those photos that see anything of what the virtual camera sees.

#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "blending.hpp"
#include "delaunay_mesh.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "light_field.hpp"
#include "surface.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

class DelaunayBlending final : public Blending {
  public:
    DelaunayBlending(const LightField& field, const VirtualViews& views, const Middle& middle,
                     const Surface& surface)
        : photos_(field.photos),
          takes_part_(std::make_unique<bool[]>(field.photos.count)),
          frustum_(views.grid.frustum_across.size() * views.grid.frustum_down.size()),
          inverse_depths_(frustum_.count()),
          mesh_(field.mesh, views.width, views.height, views.pixels, middle) {
        frustum_.set_crossings(views.grid.frustum_across, views.grid.frustum_down);
        surface.prepare(frustum_);
    }

    const RegionMap& map() const override { return mesh_.map(); }
    const bool* candidates() const override { return takes_part_.get(); }

    void choose(const VirtualCamera& camera, const Surface& surface,
                Homographies& homographies) override {
        surface.set_inverse_depths(frustum_, inverse_depths_.data());
        for (std::size_t photo = 0; photo < photos_.count; ++photo) {
            takes_part_[photo] = photos_.usable[photo] && sees_any(photo, homographies[photo]);
        }
        mesh_.build(camera, photos_.centres, takes_part_.get(), photos_.count);
    }

  private:
    /// Whether a photo sees any of the surface points that stand for the virtual frustum.
    LFNAV_INLINE bool sees_any(std::size_t photo, const Homography& homography) const {
        const std::int64_t* const size = photos_.size_of(photo);
        const double right = static_cast<double>(size[0]) - 0.5;
        const double bottom = static_cast<double>(size[1]) - 0.5;
        const auto& map = homography.map;
        const double u0 = map[0], u1 = map[1], u2 = map[2], u3 = homography.shift[0];
        const double v0 = map[3], v1 = map[4], v2 = map[5], v3 = homography.shift[1];
        const double w0 = map[6], w1 = map[7], w2 = map[8], w3 = homography.shift[2];
        std::int32_t seen = 0;
#pragma omp simd reduction(+ : seen)
        for (std::size_t i = 0; i < inverse_depths_.size(); ++i) {
            const auto x = static_cast<double>(frustum_.x[i]);
            const auto y = static_cast<double>(frustum_.y[i]);
            const auto d = static_cast<double>(inverse_depths_[i]);
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
    /// The surface points one of which a photo has to see.
    ImagePoints frustum_;
    std::vector<float> inverse_depths_;
    DelaunayMesh mesh_;
};

}  // namespace lfnav::LFNAV_LEVEL
