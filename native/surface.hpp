// The scene's surface as a virtual camera sees it: one inverse depth a pixel.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "homography.hpp"
#include "level.hpp"
#include "simd.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Pixels at which surfaces are looked up, of one virtual camera after the other.
struct ImagePoints {
    /// Columns and rows; there are some more numbers behind the last one, to be worked on together.
    std::vector<float> x, y;
    /// Of a surface with a grid of vertices: the upper left one of the cell around each pixel, and
    /// how far to the right of it and below it the pixel is, as a share of the cell.
    std::vector<std::int32_t> vertex;
    std::vector<float> right, below;

    explicit ImagePoints(std::size_t count) : x(count + TOGETHER), y(count + TOGETHER) {}
    std::size_t count() const { return x.size() - TOGETHER; }

    /// Puts them where columns and rows cross, row by row; the last one stands for those that are
    /// too many.
    void set_crossings(std::span<const std::int64_t> columns, std::span<const std::int64_t> rows) {
        const std::size_t across = columns.size(), crossings = across * rows.size();
        for (std::size_t i = 0; i < count(); ++i) {
            const std::size_t crossing = std::min(i, crossings - 1);
            x[i] = static_cast<float>(columns[crossing % across]);
            y[i] = static_cast<float>(rows[crossing / across]);
        }
    }
};

class Surface {
  public:
    virtual ~Surface() = default;
    /// Completes points, once for all cameras.
    virtual void prepare(ImagePoints&) const {}
    /// Approximates the surface for a virtual camera.
    ///
    /// @param number: of the camera among all that are asked for.
    virtual void set_camera(const VirtualCamera& camera, std::size_t number) = 0;
    /// Writes what is seen at points, 1 / metres along the optical axis; 0: nothing.
    virtual void set_inverse_depths(const ImagePoints& points, float* inverse_depths) const = 0;
};

/// One plane for the whole scene: its inverse depth is linear in the pixel.
class PlaneSurface final : public Surface {
  public:
    /// @param plane: (4,) unit normal and offset; the photos' cameras are on its positive side.
    explicit PlaneSurface(const double* plane) : plane_(plane) {}

    void set_camera(const VirtualCamera& camera, std::size_t) override {
        double distance = plane_[3];
        for (std::size_t i = 0; i < 3; ++i) {
            distance += plane_[i] * camera.pose[4 * i + 3];
        }
        // From behind nothing is seen.
        const double scale = distance > 0.0 ? -1.0 / distance : 0.0;
        for (std::size_t i = 0; i < 3; ++i) {
            coefficients_[i] =
                scale * (plane_[0] * camera.rays[i] + plane_[1] * camera.rays[3 + i] +
                         plane_[2] * camera.rays[6 + i]);
        }
    }

    void set_inverse_depths(const ImagePoints& points, float* inverse_depths) const override {
        const double right = coefficients_[0], down = coefficients_[1], start = coefficients_[2];
        const std::size_t count = points.count();
#pragma omp simd
        for (std::size_t i = 0; i < count; ++i) {
            const double value = right * static_cast<double>(points.x[i]) +
                                 down * static_cast<double>(points.y[i]) + start;
            inverse_depths[i] = static_cast<float>(value > 0.0 ? value : 0.0);
        }
    }

  private:
    const double* plane_;
    /// Of column, row, 1.
    double coefficients_[3] = {};
};

}  // namespace lfnav::LFNAV_LEVEL
