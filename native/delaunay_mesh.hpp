// The Delaunay mesh of recording centres in a virtual image, and the blending weights that it gives
// (Heigl, Denzler, Niemann 2001, section 2). The readable version is
// pipelines/render/delaunay_mesh.py.
//
// Its regions are the triangles; beyond an outer edge a strip, in which that edge's two photos are
// blended; beyond an outer corner a wedge, which its photo has alone. Where all centres are in a
// plane with the virtual one, the mesh is one-dimensional: its regions are what lies between
// neighbours along a line.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "delaunay.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "regions.hpp"
#include "scatter.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Makes one mesh after the other in the same memory.
class DelaunayMesh {
  public:
    /// @param pixels: indices in the image, rising.
    DelaunayMesh(const MeshSettings& settings, std::size_t width, std::size_t height,
                 std::span<const std::int32_t> pixels, const Middle& middle)
        : settings_(settings),
          width_(width),
          height_(height),
          first_columns_(height),
          end_columns_(height),
          inside_(height),
          delaunay_(settings.smallest_area),
          map_(width, height, pixels, middle) {}

    const RegionMap& map() const { return map_; }

    /// Makes the mesh of some photos in a virtual image.
    ///
    /// @param centres: (N, 3) of all photos.
    /// @param takes_part: (N,) which ones do; without any there are no regions.
    LFNAV_INLINE void build(const VirtualCamera& camera, const double* centres,
                            const bool* takes_part, std::size_t count) {
        map_.clear();
        project(camera, centres, takes_part, count);
        if (!points_.empty()) {
            const double share = settings_.flatness * settings_.flatness;
            bool is_flat = points_.size() < 3;
            if (!is_flat && !scatter_.is_plainly_solid(share)) {
                is_flat = scatter_.flattest_axis().spread <= share * scatter_.total();
            }
            if (is_flat || !set_triangles()) {
                set_line(line_direction(camera));
            }
        }
        map_.sort_pixels();
    }

  private:
    /// Something that is sorted, by a number and then by its index.
    struct Key {
        double value;
        std::int32_t index;
        auto operator<=>(const Key&) const = default;
    };
    struct HullEdge {
        std::int32_t first, second;
        Point start;
        double dx, dy, per_square;
    };

    static std::size_t index(std::int32_t i) { return static_cast<std::size_t>(i); }

    /// Projects the centres, the nearest first, and adds up how they scatter around the virtual
    /// one. Of those that coincide in the image the nearest stays.
    LFNAV_INLINE void project(const VirtualCamera& camera, const double* centres,
                              const bool* takes_part, std::size_t count) {
        const double* const pose = camera.pose;
        keys_.clear();
        for (std::size_t photo = 0; photo < count; ++photo) {
            if (takes_part[photo]) {
                const double* const centre = centres + 3 * photo;
                const double x = centre[0] - pose[3], y = centre[1] - pose[7],
                             z = centre[2] - pose[11];
                const double distance = std::sqrt(x * x + y * y + z * z);
                constexpr double most = std::numeric_limits<double>::max();
                keys_.push_back(
                    {distance < most ? distance : most, static_cast<std::int32_t>(photo)});
            }
        }
        std::sort(keys_.begin(), keys_.end());
        points_.clear();
        photos_.clear();
        scatter_.clear();
        for (const Key& key : keys_) {
            const double* const centre = centres + 3 * index(key.index);
            const Point point = projected_centre(centre, camera);
            const double limit = std::max(
                settings_.coincident_pixels,
                settings_.coincident_share * std::max(std::abs(point.x), std::abs(point.y)));
            std::int32_t coincident = 0;
#pragma omp simd reduction(+ : coincident)
            for (std::size_t i = 0; i < points_.size(); ++i) {
                const bool is_near = (std::abs(points_[i].x - point.x) <= limit) &
                                     (std::abs(points_[i].y - point.y) <= limit);
                coincident += is_near ? 1 : 0;
            }
            if (coincident > 0) {
                continue;
            }
            points_.push_back(point);
            photos_.push_back(key.index);
            const double offset[3] = {centre[0] - pose[3], centre[1] - pose[7],
                                      centre[2] - pose[11]};
            scatter_.add(offset);
        }
    }

    /// Unit direction of the line on which centres project that are in a plane with the virtual
    /// one.
    Point line_direction(const VirtualCamera& camera) const {
        Point along = {0.0, 0.0};
        if (points_.size() == 2) {
            // Two define their own line, whatever the plane through them.
            along = {points_[1].x - points_[0].x, points_[1].y - points_[0].y};
        } else {
            const Scatter::Axis normal = scatter_.flattest_axis();
            for (std::size_t i = 0; i < 3; ++i) {
                along.x -= camera.pose[4 * i + 1] * normal.direction[i] / camera.fy;
                along.y += camera.pose[4 * i] * normal.direction[i] / camera.fx;
            }
        }
        const double length = std::sqrt(along.x * along.x + along.y * along.y);
        // A plane that has the whole horizon of the image leaves the direction open: take rows.
        constexpr double SMALLEST_LENGTH = 1e-12;
        if (!(length * std::max(camera.fx, camera.fy) >= SMALLEST_LENGTH)) {
            return {1.0, 0.0};
        }
        return {along.x / length, along.y / length};
    }

    /// Sets the regions of a one-dimensional mesh: one below, one between any two, one above the
    /// centres along a line.
    LFNAV_INLINE void set_line(const Point& direction) {
        keys_.clear();
        for (std::size_t i = 0; i < points_.size(); ++i) {
            const double place = points_[i].x * direction.x + points_[i].y * direction.y;
            keys_.push_back({place == place ? place : 0.0, static_cast<std::int32_t>(i)});
        }
        std::sort(keys_.begin(), keys_.end());
        const std::size_t count = keys_.size();
        region_of_.assign(count + 1, -1);
        for (std::size_t y = 0; y < height_; ++y) {
            const double start = static_cast<double>(y) * direction.y;
            for (std::size_t x = 0; x < width_;) {
                const double place = start + static_cast<double>(x) * direction.x;
                const auto above = std::partition_point(
                    keys_.begin(), keys_.end(), [&](const Key& key) { return key.value <= place; });
                const auto interval = static_cast<std::size_t>(above - keys_.begin());
                // Where the line gets to the next of them in the direction of the row.
                const bool is_rising = direction.x > 0.0;
                const std::size_t next = is_rising ? interval : interval - 1;
                std::size_t end = width_;
                if (direction.x != 0.0 && next < count) {
                    end = column_from((keys_[next].value - start) / direction.x);
                }
                end = std::min(std::max(end, x + 1), width_);
                std::int32_t& region = region_of_[interval];
                if (region < 0) {
                    region = map_.add(x, y);
                    add_interval(interval, direction, place);
                }
                map_.add_run(region, map_.before(y, x), map_.before(y, end));
                x = end;
            }
        }
    }

    void add_interval(std::size_t interval, const Point& direction, double place) {
        const Key& first = keys_[interval > 0 ? interval - 1 : 0];
        const Key& second = keys_[std::min(interval, keys_.size() - 1)];
        const double width = second.value - first.value;
        if (interval == 0 || interval == keys_.size() || !(width > 0.0)) {
            map_.add_photo(photos_[index(first.index)], 0.0, 0.0, 1.0);
        } else {
            add_ramp(first.index, second.index, direction.x / width, direction.y / width,
                     (place - first.value) / width);
        }
    }

    /// Sets the regions of a two-dimensional mesh; returns false where the centres are on a line.
    LFNAV_INLINE bool set_triangles() {
        if (!delaunay_(points_)) {
            return false;
        }
        hull_.clear();
        std::fill(inside_.begin(), inside_.end(), std::pair{width_, std::size_t{0}});
        delaunay_.for_each([&](const Delaunay::Triangle& triangle) {
            if (triangle.corner[2] == Delaunay::GHOST) {
                const Point &a = points_[index(triangle.corner[0])],
                            &b = points_[index(triangle.corner[1])];
                const double dx = b.x - a.x, dy = b.y - a.y;
                hull_.push_back(
                    {triangle.corner[0], triangle.corner[1], a, dx, dy, 1.0 / (dx * dx + dy * dy)});
            } else {
                fill(triangle);
            }
        });
        region_of_.assign(2 * hull_.size(), -1);
        for (std::size_t row = 0; row < height_ && !hull_.empty(); ++row) {
            const auto [first, end] = inside_[row];
            fill_outside(map_.before(row, 0), map_.before(row, std::min(first, width_)));
            if (first < end) {
                fill_outside(map_.before(row, end), map_.before(row, width_));
            }
        }
        return !hull_.empty();
    }

    /// The first column at a place or to the right of it.
    LFNAV_INLINE std::size_t column_from(double place) const {
        return index(rounded_up(place, static_cast<double>(width_)));
    }

    /// Rounded up, and no number and what is out of range to a border of it.
    LFNAV_INLINE static std::int32_t rounded_up(double place, double end) {
        const double from_zero = place > 0.0 ? place : 0.0;
        const double bounded = from_zero < end ? from_zero : end;
        const auto whole = static_cast<std::int32_t>(bounded);
        return whole + (static_cast<double>(whole) < bounded ? 1 : 0);
    }

    /// Adds a triangle that has pixels: those inside, half-open towards larger columns and rows.
    LFNAV_INLINE void fill(const Delaunay::Triangle& triangle) {
        Point a = points_[index(triangle.corner[0])], b = points_[index(triangle.corner[1])],
              c = points_[index(triangle.corner[2])];
        // An edge runs down wherever it belongs: triangles on both sides meet without a crack.
        const auto sort = [](Point& upper, Point& lower) {
            if (upper.y > lower.y || (upper.y == lower.y && upper.x > lower.x)) {
                std::swap(upper, lower);
            }
        };
        sort(a, b);
        sort(b, c);
        sort(a, b);
        const double right = static_cast<double>(width_), bottom = static_cast<double>(height_);
        const std::int32_t top = rounded_up(a.y, bottom), end = rounded_up(c.y, bottom);
        if (top >= end || std::max({a.x, b.x, c.x}) <= 0.0 ||
            std::min({a.x, b.x, c.x}) > right - 1.0) {
            return;
        }
        const double whole = (c.x - a.x) / (c.y - a.y);
        const double upper = (b.x - a.x) / (b.y - a.y), lower = (c.x - b.x) / (c.y - b.y);
        std::int32_t *const firsts = first_columns_.data(), *const ends = end_columns_.data();
#pragma omp simd
        for (std::int32_t row = top; row < end; ++row) {
            const auto y = static_cast<double>(row);
            const double one = a.x + (y - a.y) * whole;
            const double above = a.x + (y - a.y) * upper, below = b.x + (y - b.y) * lower;
            const double other = y < b.y ? above : below;
            firsts[row] = rounded_up(one < other ? one : other, right);
            ends[row] = rounded_up(one < other ? other : one, right);
        }
        std::int32_t region = -1;
        // Wherever the pixels are that are rendered, what they show has to be the same.
        std::pair<std::size_t, std::size_t> origin = {width_, 0};
        for (std::size_t row = index(top); row < index(end); ++row) {
            const std::size_t first_column = index(firsts[row]), end_column = index(ends[row]);
            if (first_column >= end_column) {
                continue;
            }
            origin = origin.first < width_ ? origin : std::pair{first_column, row};
            inside_[row].first = std::min(inside_[row].first, first_column);
            inside_[row].second = std::max(inside_[row].second, end_column);
            const std::int32_t from = map_.before(row, first_column);
            const std::int32_t to = map_.before(row, end_column);
            if (from < to) {
                if (region < 0) {
                    region = add_triangle(triangle, origin.first, origin.second);
                }
                map_.add_run(region, from, to);
            }
        }
    }

    /// Weights are barycentric coordinates.
    std::int32_t add_triangle(const Delaunay::Triangle& triangle, std::size_t column,
                              std::size_t row) {
        const std::int32_t region = map_.add(column, row);
        const auto corner = [&](std::size_t i) { return points_[index(triangle.corner[i % 3])]; };
        const Point origin = {static_cast<double>(column), static_cast<double>(row)};
        const double share = 1.0 / area(corner(0), corner(1), corner(2));
        for (std::size_t i = 0; i < 3; ++i) {
            const Point p = corner(i + 1), q = corner(i + 2);
            map_.add_photo(photos_[index(triangle.corner[i])], (p.y - q.y) * share,
                           (q.x - p.x) * share, area(origin, p, q) * share);
        }
        return region;
    }

    /// Adds some pixels outside of the triangles to the strips and wedges that they are in.
    LFNAV_INLINE void fill_outside(std::int32_t first, std::int32_t end) {
        while (first < end) {
            const std::size_t part = nearest_part(first);
            std::int32_t last = end - 1, beyond = end - 1;
            // Strips and wedges are convex: what is between two pixels of one is of it, too.
            if (nearest_part(last) != part) {
                last = first;
                while (beyond - last > 1) {
                    const std::int32_t between = (last + beyond) / 2;
                    (nearest_part(between) == part ? last : beyond) = between;
                }
            }
            std::int32_t& region = region_of_[part];
            if (region < 0) {
                region = add_outer_region(part);
            }
            map_.add_run(region, first, last + 1);
            first = last + 1;
        }
    }

    /// The hull edge whose strip a pixel is in or, plus their number, whose first corner's wedge.
    LFNAV_INLINE std::size_t nearest_part(std::int32_t pixel) const {
        const auto [column, row] = map_.place_of(pixel);
        const Point p = {column, row};
        std::size_t nearest = 0;
        double shortest = std::numeric_limits<double>::infinity();
        for (std::size_t i = 0; i < hull_.size(); ++i) {
            const HullEdge& edge = hull_[i];
            const double x = p.x - edge.start.x, y = p.y - edge.start.y;
            const double along = (x * edge.dx + y * edge.dy) * edge.per_square;
            // A corner belongs to the edge that starts there; the one that ends there leaves it.
            if (along > 1.0) {
                continue;
            }
            const double clamped = std::max(along, 0.0);
            const double across = x - clamped * edge.dx, down = y - clamped * edge.dy;
            const double square = across * across + down * down;
            if (square < shortest) {
                shortest = square;
                nearest = along > 0.0 ? i : hull_.size() + i;
            }
        }
        return nearest;
    }

    std::int32_t add_outer_region(std::size_t part) {
        const HullEdge& edge = hull_[part % hull_.size()];
        const std::size_t column = column_from(edge.start.x),
                          row = index(rounded_up(edge.start.y, static_cast<double>(height_)));
        const std::int32_t region = map_.add(column, row);
        if (part >= hull_.size()) {
            map_.add_photo(photos_[index(edge.first)], 0.0, 0.0, 1.0);
        } else {
            const double a = edge.dx * edge.per_square, b = edge.dy * edge.per_square;
            add_ramp(edge.first, edge.second, a, b,
                     (static_cast<double>(column) - edge.start.x) * a +
                         (static_cast<double>(row) - edge.start.y) * b);
        }
        return region;
    }

    /// Adds the photos of two corners whose weights sum up to 1; given are those of the second one.
    void add_ramp(std::int32_t first, std::int32_t second, double a, double b, double c) {
        map_.add_photo(photos_[index(first)], -a, -b, 1.0 - c);
        map_.add_photo(photos_[index(second)], a, b, c);
    }

    MeshSettings settings_;
    std::size_t width_, height_;
    /// Corners of the mesh: where they are, and the photos that were taken there.
    std::vector<Point> points_;
    std::vector<std::int32_t> photos_;
    std::vector<Key> keys_;
    /// Of the centres around the virtual one.
    Scatter scatter_;
    /// Row by row: columns of a triangle, and of all of them.
    std::vector<std::int32_t> first_columns_, end_columns_;
    std::vector<std::pair<std::size_t, std::size_t>> inside_;
    Delaunay delaunay_;
    std::vector<HullEdge> hull_;
    /// Of intervals, or of strips and wedges; -1: none yet.
    std::vector<std::int32_t> region_of_;
    RegionMap map_;
};

}  // namespace lfnav::LFNAV_LEVEL
