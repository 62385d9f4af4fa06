// The Delaunay meshes of recording centres in virtual images as tables, for the GPU.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "delaunay_mesh.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

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
    /// Capacity: regions of each view at most.
    std::size_t most;
    /// (B, most, 3) photos of each region; -1: none.
    std::int32_t* photos;
    /// (B, most, 3, 4) their weights: coefficients of x, y, 1, x y, from the image's middle.
    float* weights;
    /// (B, H, W) each pixel's region; -1: none.
    std::int32_t* regions;
};

/// Makes meshes; returns the largest number of regions.
inline std::size_t set_mesh_tables(const MeshedViews& views, const MeshSettings& settings,
                                   const MeshTables& tables) {
    constexpr std::size_t PHOTOS = 3;
    const std::size_t pixel_count = views.width * views.height;
    std::vector<std::int32_t> pixels(pixel_count);
    std::iota(pixels.begin(), pixels.end(), 0);
    const double middle_x = 0.5 * (static_cast<double>(views.width) - 1.0);
    const double middle_y = 0.5 * (static_cast<double>(views.height) - 1.0);
    DelaunayMesh mesh(settings, views.width, views.height, pixels, {0, 0});
    std::fill_n(tables.photos, PHOTOS * tables.most * views.count, -1);
    std::fill_n(tables.regions, pixel_count * views.count, -1);
    std::size_t largest = 0;
    for (std::size_t number = 0; number < views.count; ++number) {
        const VirtualCamera camera(views.poses + 16 * number, views.intrinsics);
        mesh.build(camera, views.centres, views.takes_part + views.photos * number, views.photos);
        const std::span<const Region> regions = mesh.map().regions();
        const std::size_t count = std::min(regions.size(), tables.most);
        for (std::size_t i = 0; i < count; ++i) {
            const Region& region = regions[i];
            const std::size_t own = PHOTOS * (tables.most * number + i);
            std::copy_n(region.photo, region.count, tables.photos + own);
            for (std::size_t slot = 0; slot < region.count; ++slot) {
                const double a = static_cast<double>(region.a[slot]);
                const double b = static_cast<double>(region.b[slot]);
                float* const weights = tables.weights + 4 * (own + slot);
                weights[0] = region.a[slot];
                weights[1] = region.b[slot];
                weights[2] = static_cast<float>(static_cast<double>(region.c[slot]) +
                                                a * (middle_x - static_cast<double>(region.left)) +
                                                b * (middle_y - static_cast<double>(region.top)));
            }
            const RegionPixels& ordered = mesh.map().pixels();
            for (std::size_t k = ordered.starts[i]; k < ordered.starts[i + 1]; ++k) {
                const auto pixel = static_cast<std::size_t>(ordered.place[k]);
                tables.regions[pixel_count * number + pixel] = static_cast<std::int32_t>(i);
            }
        }
        largest = std::max(largest, count);
    }
    return largest;
}

}  // namespace lfnav::LFNAV_LEVEL
