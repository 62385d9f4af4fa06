// The Delaunay meshes of recording centres in virtual images as tables, for the GPU; and the
// triangulation alone, for tests.

#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "instruction_set.hpp"
#include "virtual_views.hpp"

namespace lfnav {

/// What meshes are made of.
struct MeshedViews {
    /// (B, 4, 4) world_from_camera.
    const double* poses;
    std::size_t count;
    /// (4,) fx, fy, cx, cy.
    const double* intrinsics;
    std::size_t width, height;
    /// (N, 3) recording centres, and (B, N) which of them are in each view's mesh.
    const double* centres;
    const bool* takes_part;
    std::size_t photos;
};

/// Of each view the regions that have pixels.
struct MeshTables {
    /// Regions that there is room for.
    std::size_t most;
    /// (B, most, 3) photos of each region; -1: none.
    std::int32_t* photos;
    /// (B, most, 3, 4) their weights: coefficients of x, y, 1, x y, from the image's middle.
    float* weights;
    /// (B, H, W) each pixel's region; -1: none.
    std::int32_t* regions;
};

/// Makes meshes; returns the largest number of regions.
LFNAV_DECLARE(std::size_t set_mesh_tables(const MeshedViews& views, const MeshSettings& settings,
                                          const MeshTables& tables))

/// The Delaunay triangles of points (N, 2): three corners each, of a hull edge two and -1.
LFNAV_DECLARE(std::vector<std::int32_t> triangulated(std::span<const double> points,
                                                     double smallest_area))

}  // namespace lfnav
