// What of the photos' depth maps is projected into virtual images.

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "light_field.hpp"

namespace lfnav {

/// Samples of some photos' depth maps, in batches of samples that are near each other.
///
/// In a batch neighbours do not follow each other: numbers that are written to one place, one after
/// the other, wait for each other. A photo's last sample fills up its last batch.
struct DepthSamples {
    /// Samples in a batch, and batches that are looked at together.
    static constexpr std::size_t BATCH = 64, BATCHES = 16;

    /// (N,) each photo's first batch, and the one behind its last.
    std::vector<std::size_t> starts, ends;
    /// (B, 3, BATCH) columns and rows in the depth map, from its middle, and inverse depths.
    std::unique_ptr<float[]> values;
    /// (6, length) around batches: the middles of columns, rows and inverse depths, and how far
    /// these go from there; for more batches than there are, BATCHES at least.
    std::vector<float> boxes;
    std::size_t length, count;

    /// @param is_source: (N,) whose depth maps are sampled.
    /// @param steps: (N,) from one sample to the next, at least 1 pixel.
    DepthSamples(const Photos& photos, std::span<const bool> is_source,
                 std::span<const double> steps);
};

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
