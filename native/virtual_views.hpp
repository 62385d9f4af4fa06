// What is rendered and compared: a light field, virtual views of it, and costs.

#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "depth_samples.hpp"
#include "image.hpp"
#include "light_field.hpp"

namespace lfnav {

/// Constants of the penalty, of which pipelines/render/blending.py says what they are.
struct PenaltySettings {
    float resolution, border, smallest_margin, smallest;
};

/// Limits of the Delaunay mesh, of which pipelines/render/delaunay_mesh.py says what they are.
struct MeshSettings {
    double flatness, coincident_pixels, coincident_share, smallest_area;

    static MeshSettings of(const double* limits) {
        return {limits[0], limits[1], limits[2], limits[3]};
    }
};

/// Where points are looked at in images of one size: columns and rows of the tiles' corners, of the
/// probes by which many photos are narrowed down, and of the points one of which a photo of the
/// Delaunay mesh has to show.
struct Grid {
    std::span<const std::int64_t> across, down, probes_across, probes_down;
    std::span<const std::int64_t> frustum_across, frustum_down;
};

/// How vertices with depths become a surface; pipelines/render/surface.py says what these are.
struct DepthGridSettings {
    float pinhole_factor;
    std::int32_t pinhole_neighbours;
    float edge_factor;
    double largest_gap_share;
};

/// Kinds of comparison, see pipelines/render/comparison.py.
enum class Cost { SQUARED, ROBUST, ZNCC, GRADIENT, EVIDENCE };

struct CostSettings {
    /// Limits of differences, grey levels.
    float robust_limit, gradient_limit;
    /// What an uncovered pixel costs.
    double uncovered_squared, uncovered_robust, uncovered_zncc, uncovered_gradient;
    double largest_gain;
    /// Of EVIDENCE: rows of so many bins of so many grey levels; the first row is zeros.
    std::span<const float> evidence;
    std::size_t evidence_bins;
    float evidence_bin;
};

/// A light field and how it is rendered.
struct LightField {
    Photos photos;
    PhotoIndex index;
    /// (4,) unit normal and offset; the photos' cameras are on its positive side.
    const double* plane;
    DepthGridSettings depth_grid;
    PenaltySettings penalties;
    /// More photos than these are narrowed down before they are ranked.
    std::size_t most_ranked;
    /// Below this sum of weights the photos of a region do not show a pixel.
    float smallest_weight;
    /// Whether photos are blended by the Delaunay mesh of their centres; else as an unstructured
    /// lumigraph.
    bool has_mesh;
    MeshSettings mesh;
};

/// Which pixels of which virtual cameras are rendered.
struct VirtualViews {
    /// (B, 4, 4) world_from_camera.
    const double* poses;
    std::size_t count;
    /// (4,) fx, fy, cx, cy.
    const double* intrinsics;
    std::size_t width, height;
    Grid grid;
    /// Indices of the pixels in the image, rising.
    std::span<const std::int32_t> pixels;
    /// Of the depth maps that make the surface; none: it is the plane.
    std::optional<DepthSamples> samples;
    /// (B, most_sources) whose these are, for each camera; -1: none.
    const std::int32_t* sources;
    std::size_t most_sources;
    /// Of the vertices that approximate it, pixels.
    double spacing;
};

/// What views are compared with.
struct Comparison {
    Cost cost;
    /// As many pixels as are rendered.
    MaskedImage query;
    bool fit_gain;
    CostSettings settings;
};

}  // namespace lfnav
