// What of the photos' depth maps is projected into virtual images.

#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace lfnav {

/// Samples of some photos' depth maps, in batches of samples that are near each other, see
/// pipelines/render/depth_samples.py.
struct DepthSamples {
    /// Samples in a batch, and batches that are looked at together.
    static constexpr std::size_t BATCH = 64, BATCHES = 16;

    /// (N,) each photo's first batch, and the one behind its last.
    std::span<const std::int64_t> starts, ends;
    /// (B, 3, BATCH) columns and rows in the depth map, from its middle, and inverse depths.
    const float* values;
    /// (6, length) around batches: the middles of columns, rows and inverse depths, and how far
    /// these go from there; for BATCHES more than there are at least.
    const float* boxes;
    std::size_t length;
};

}  // namespace lfnav
