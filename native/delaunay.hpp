// Delaunay triangulation of points in the plane.
//
// The incremental algorithm of Bowyer and Watson (1981) with ghost triangles: the corner GHOST is
// the point at infinity, so that the hull needs no artificial triangle around it.
//
// A camera gantry records on a regular grid: any four neighbours lie on a circle, whole rows on a
// line. Rounding then decides whether a point is in a circumcircle, and the triangles in conflict
// need neither hang together nor surround the point. So the cavity grows from the triangle that the
// point is in, across edges only, and goes on growing until the point sees all of its rim. A corner
// that is left with no triangle by that, all but on a line with the point, is inserted once more.
// The result always is a triangulation, and the Delaunay triangulation to within rounding.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "homography.hpp"
#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Twice the signed area of a triangle, positive when a, b, c turn from x towards y.
inline double area(const Point& a, const Point& b, const Point& c) {
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

/// Makes one triangulation after the other in the same memory.
class Delaunay {
  public:
    static constexpr std::int32_t GHOST = -1;

    /// The neighbours are those across the edges from each corner to the next one. In a ghost
    /// triangle the third corner is GHOST, and the first two are a hull edge with the hull on its
    /// right.
    struct Triangle {
        std::int32_t corner[3], neighbour[3];
    };

    /// @param smallest_area: a triangle flatter than this share of the square of its longest side
    ///     counts as a line.
    explicit Delaunay(double smallest_area) : smallest_area_(smallest_area) {}

    /// Triangulates distinct points; returns false where all of them lie on a line.
    bool operator()(std::span<const Point> points) {
        points_ = points;
        triangles_.clear();
        is_removed_.clear();
        new_at_.assign(points.size() + 1, 0);
        lost_.clear();
        const auto count = static_cast<std::int32_t>(points.size());
        std::int32_t third = 2;
        while (third < count && turn(0, 1, points[index(third)]) == 0.0) {
            ++third;
        }
        if (third >= count) {
            return false;
        }
        const bool is_left = turn(0, 1, points[index(third)]) > 0.0;
        const std::int32_t a = is_left ? 0 : 1, b = 1 - a, c = third;
        // Seen from outside, a hull edge runs the other way round.
        triangles_ = {
            {{a, b, c}, {1, 2, 3}},
            {{b, a, GHOST}, {0, 3, 2}},
            {{c, b, GHOST}, {0, 1, 3}},
            {{a, c, GHOST}, {0, 2, 1}},
        };
        is_removed_.assign(triangles_.size(), 0);
        latest_ = 0;
        for (std::int32_t i = 2; i < count; ++i) {
            if (i != third) {
                insert(i);
            }
        }
        // One after the other may be lost by what brings the last one back, but not for ever.
        for (std::int32_t tries = 0; tries < count && !lost_.empty(); ++tries) {
            const std::int32_t corner = lost_.back();
            lost_.pop_back();
            insert(corner);
        }
        return true;
    }

    /// Calls a function with each triangle, ghosts included.
    template <typename Function>
    void for_each(Function function) const {
        for (std::size_t row = 0; row < triangles_.size(); ++row) {
            if (is_removed_[row] == 0) {
                function(triangles_[row]);
            }
        }
    }

  private:
    /// An edge of the cavity's rim and the triangle beyond it.
    struct RimEdge {
        std::int32_t start, end, beyond;
    };

    static constexpr std::int32_t ON_RIM = -1;

    static std::size_t index(std::int32_t i) { return static_cast<std::size_t>(i); }

    /// The area of two corners and a point; zero where they lie on a line to within rounding.
    double turn(std::int32_t first, std::int32_t second, const Point& c) const {
        const Point &a = points_[index(first)], &b = points_[index(second)];
        const auto square = [](double x, double y) { return x * x + y * y; };
        const double longest = std::max({square(b.x - a.x, b.y - a.y), square(c.x - a.x, c.y - a.y),
                                         square(c.x - b.x, c.y - b.y)});
        const double size = area(a, b, c);
        return std::abs(size) > smallest_area_ * longest ? size : 0.0;
    }

    /// Whether a point on the line through two others lies between them.
    static bool is_beside(const Point& a, const Point& b, const Point& p) {
        return (p.x - a.x) * (b.x - p.x) + (p.y - a.y) * (b.y - p.y) > 0.0;
    }

    /// Whether a point is in the circumcircle of a triangle; of a ghost: beyond its hull edge.
    bool conflicts(const Triangle& triangle, const Point& p) const {
        const Point &a = points_[index(triangle.corner[0])],
                    &b = points_[index(triangle.corner[1])];
        if (triangle.corner[2] == GHOST) {
            const double side = turn(triangle.corner[0], triangle.corner[1], p);
            return side != 0.0 ? side > 0.0 : is_beside(a, b, p);
        }
        const Point& c = points_[index(triangle.corner[2])];
        const double ax = a.x - p.x, ay = a.y - p.y, bx = b.x - p.x, by = b.y - p.y;
        const double cx = c.x - p.x, cy = c.y - p.y;
        return (ax * ax + ay * ay) * (bx * cy - cx * by) -
                   (bx * bx + by * by) * (ax * cy - cx * ay) +
                   (cx * cx + cy * cy) * (ax * by - bx * ay) >
               0.0;
    }

    /// How far a point is inside a triangle, relative to its sides; negative outside.
    double depth_inside(const Triangle& triangle, const Point& p) const {
        double depth = std::numeric_limits<double>::infinity();
        const std::size_t sides = triangle.corner[2] == GHOST ? 1 : 3;
        for (std::size_t i = 0; i < sides; ++i) {
            const Point& a = points_[index(triangle.corner[i])];
            const Point& b = points_[index(triangle.corner[(i + 1) % 3])];
            const double dx = b.x - a.x, dy = b.y - a.y;
            depth = std::min(depth, area(a, b, p) / (dx * dx + dy * dy));
        }
        return depth;
    }

    /// The triangle that a point is in: in conflict with it, unless rounding hides that.
    std::int32_t locate(const Point& p) const {
        std::int32_t row = latest_;
        // Rounding may lead a walk in a circle.
        for (std::size_t steps = 0; steps < triangles_.size(); ++steps) {
            const Triangle& triangle = triangles_[index(row)];
            std::size_t side = 0;
            while (side < 3 && triangle.corner[2] != GHOST &&
                   area(points_[index(triangle.corner[side])],
                        points_[index(triangle.corner[(side + 1) % 3])], p) >= 0.0) {
                ++side;
            }
            if (triangle.corner[2] == GHOST || side == 3) {
                break;
            }
            row = triangle.neighbour[side];
        }
        if (is_removed_[index(row)] == 0 && conflicts(triangles_[index(row)], p)) {
            return row;
        }
        const std::int32_t found = deepest(p, true);
        return found >= 0 ? found : deepest(p, false);
    }

    /// The triangle that a point is deepest in, of those in conflict with it or of all.
    std::int32_t deepest(const Point& p, bool in_conflict) const {
        std::int32_t best = -1;
        double depth = -std::numeric_limits<double>::infinity();
        for (std::size_t i = 0; i < triangles_.size(); ++i) {
            if (is_removed_[i] == 0 && (!in_conflict || conflicts(triangles_[i], p))) {
                const double own = depth_inside(triangles_[i], p);
                if (own > depth) {
                    depth = own;
                    best = static_cast<std::int32_t>(i);
                }
            }
        }
        return best;
    }

    /// Whether a point does not see an edge from inside. One that all but lies on the edge does
    /// not; one on its extension does, if only just: else all triangles along a straight row would
    /// go.
    bool is_hidden(std::int32_t start, std::int32_t end, const Point& p) const {
        if (turn(start, end, p) > 0.0) {
            return false;
        }
        const Point &a = points_[index(start)], &b = points_[index(end)];
        return is_beside(a, b, p) || area(a, b, p) <= 0.0;
    }

    void remove(std::int32_t row) {
        is_removed_[index(row)] = 1;
        cavity_.push_back(row);
    }

    /// Sets the rim of the cavity; returns a triangle that hides part of it from a point, or -1.
    std::int32_t set_rim(const Point& p) {
        rim_.clear();
        for (const std::int32_t row : cavity_) {
            const Triangle& triangle = triangles_[index(row)];
            for (std::size_t i = 0; i < 3; ++i) {
                const std::int32_t start = triangle.corner[i], end = triangle.corner[(i + 1) % 3];
                const std::int32_t beyond = triangle.neighbour[i];
                if (is_removed_[index(beyond)] != 0) {
                    continue;
                }
                if (start != GHOST && end != GHOST && is_hidden(start, end, p)) {
                    return beyond;
                }
                rim_.push_back({start, end, beyond});
            }
        }
        return -1;
    }

    /// Replaces the triangles in conflict with a point by the fan from it to their rim.
    void insert(std::int32_t corner) {
        const Point p = points_[index(corner)];
        cavity_.clear();
        if (const std::int32_t around = locate(p); around >= 0) {
            remove(around);
        }
        for (std::size_t grown = 0; grown < cavity_.size();) {
            for (; grown < cavity_.size(); ++grown) {
                for (const std::int32_t beyond : triangles_[index(cavity_[grown])].neighbour) {
                    if (is_removed_[index(beyond)] == 0 &&
                        conflicts(triangles_[index(beyond)], p)) {
                        remove(beyond);
                    }
                }
            }
            if (const std::int32_t hiding = set_rim(p); hiding >= 0) {
                remove(hiding);
            }
        }
        if (!cavity_.empty()) {
            note_lost();
            fill_cavity(corner);
        }
    }

    /// Notes the corners inside the cavity: no triangle but those that are removed has them.
    void note_lost() {
        for (const RimEdge& edge : rim_) {
            new_at_[index(edge.start + 1)] = ON_RIM;
        }
        for (const std::int32_t row : cavity_) {
            for (const std::int32_t own : triangles_[index(row)].corner) {
                if (std::exchange(new_at_[index(own + 1)], ON_RIM) != ON_RIM && own != GHOST) {
                    lost_.push_back(own);
                }
            }
        }
        for (const std::int32_t row : cavity_) {
            for (const std::int32_t own : triangles_[index(row)].corner) {
                new_at_[index(own + 1)] = 0;
            }
        }
    }

    /// Adds the triangles between a point and the rim.
    void fill_cavity(std::int32_t corner) {
        const auto new_at = [&](std::int32_t start) -> std::int32_t& {
            return new_at_[index(start + 1)];
        };
        for (std::size_t i = 0; i < rim_.size(); ++i) {
            if (i == cavity_.size()) {
                cavity_.push_back(static_cast<std::int32_t>(triangles_.size()));
                triangles_.emplace_back();
                is_removed_.push_back(1);
            }
            new_at(rim_[i].start) = cavity_[i];
        }
        for (std::size_t i = 0; i < rim_.size(); ++i) {
            const auto [start, end, beyond] = rim_[i];
            const std::int32_t row = cavity_[i], next = new_at(end);
            is_removed_[index(row)] = 0;
            latest_ = row;
            // The ghost is the last corner; turning the corners keeps the orientation.
            Triangle& own = triangles_[index(row)];
            const std::size_t first = start == GHOST ? 2 : (end == GHOST ? 1 : 0);
            own.corner[first] = start;
            own.corner[(first + 1) % 3] = end;
            own.corner[(first + 2) % 3] = corner;
            own.neighbour[first] = beyond;
            own.neighbour[(first + 1) % 3] = next;
            Triangle& outer = triangles_[index(beyond)];
            for (std::size_t k = 0; k < 3; ++k) {
                if (outer.corner[k] == end && outer.corner[(k + 1) % 3] == start) {
                    outer.neighbour[k] = row;
                }
            }
        }
        for (std::size_t i = 0; i < rim_.size(); ++i) {
            const std::int32_t row = cavity_[i];
            Triangle& next = triangles_[index(new_at(rim_[i].end))];
            // From the point to its start.
            for (std::size_t k = 0; k < 3; ++k) {
                if (next.corner[k] == corner) {
                    next.neighbour[k] = row;
                }
            }
        }
    }

    double smallest_area_;
    std::span<const Point> points_;
    std::vector<Triangle> triangles_;
    std::vector<std::uint8_t> is_removed_;
    std::int32_t latest_ = 0;
    std::vector<std::int32_t> cavity_;
    std::vector<RimEdge> rim_;
    /// By corner, GHOST first: the new triangle whose rim edge starts there.
    std::vector<std::int32_t> new_at_;
    std::vector<std::int32_t> lost_;
};

}  // namespace lfnav::LFNAV_LEVEL
