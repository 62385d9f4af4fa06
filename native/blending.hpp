// Which photos are blended where in a virtual image.

#pragma once

#include "homography.hpp"
#include "level.hpp"
#include "regions.hpp"
#include "surface.hpp"

namespace lfnav::LFNAV_LEVEL {

class Blending {
  public:
    virtual ~Blending() = default;
    /// Chooses the regions for a virtual camera, their photos, and the weights of these.
    ///
    /// @param surface: as the camera sees it.
    /// @param homographies: for the camera.
    virtual void choose(const VirtualCamera& camera, const Surface& surface,
                        Homographies& homographies) = 0;
    virtual const RegionMap& map() const = 0;
    /// (N,) photos that may show what those of a region do not.
    virtual const bool* candidates() const = 0;
};

}  // namespace lfnav::LFNAV_LEVEL
