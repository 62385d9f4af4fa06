#include "delaunay_tables.hpp"

#include <algorithm>
#include <numeric>

#include "delaunay.hpp"
#include "delaunay_mesh.hpp"
#include "homography.hpp"
#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

std::size_t set_mesh_tables(const MeshedViews& views, const MeshSettings& settings,
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
        const std::span<const Region> regions = mesh.regions();
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
            const RegionPixels& ordered = mesh.pixels();
            for (std::size_t k = ordered.starts[i]; k < ordered.starts[i + 1]; ++k) {
                const auto pixel = static_cast<std::size_t>(ordered.place[k]);
                tables.regions[pixel_count * number + pixel] = static_cast<std::int32_t>(i);
            }
        }
        largest = std::max(largest, count);
    }
    return largest;
}

std::vector<std::int32_t> triangulated(std::span<const double> points, double smallest_area) {
    std::vector<Point> places;
    for (std::size_t i = 0; i + 1 < points.size(); i += 2) {
        places.push_back({points[i], points[i + 1]});
    }
    std::vector<std::int32_t> corners;
    Delaunay delaunay(smallest_area);
    if (delaunay(places)) {
        delaunay.for_each([&](const Delaunay::Triangle& triangle) {
            corners.insert(corners.end(), triangle.corner, triangle.corner + 3);
        });
    }
    return corners;
}

}  // namespace lfnav::LFNAV_LEVEL
