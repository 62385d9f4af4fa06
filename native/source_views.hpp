// The photos whose depth maps make the surface that a camera sees.

#pragma once

#include <cstdint>
#include <span>

#include "light_field.hpp"

namespace lfnav {

/// Chooses the photos whose depth maps show best what a camera sees: the nearest in place and
/// direction.
///
/// @param pose: (4, 4) world_from_camera.
/// @param usual_inverse_depth: what is near in this scene, 1 / metres.
/// @param turn_cost: how many such distances a rotation by a radian costs.
/// @param sources: receives at least one, the best first; -1 behind the last.
void choose_sources(const Photos& photos, const double* pose, double usual_inverse_depth,
                    double turn_cost, std::span<std::int32_t> sources);

}  // namespace lfnav
