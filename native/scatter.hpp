// How recording centres scatter around the virtual one: whether they are in a plane with it.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "level.hpp"

namespace lfnav::LFNAV_LEVEL {

class Scatter {
  public:
    /// An axis, and the sum of squares along it.
    struct Axis {
        double direction[3], spread;
    };

    void clear() { std::fill_n(&matrix_[0][0], 9, 0.0); }

    void add(const double* offset) {
        for (std::size_t i = 0; i < 3; ++i) {
            for (std::size_t j = 0; j < 3; ++j) {
                matrix_[i][j] += offset[i] * offset[j];
            }
        }
    }

    double total() const { return matrix_[0][0] + matrix_[1][1] + matrix_[2][2]; }

    /// Whether it is plain without eigenvalues that there is no axis with so small a share of the
    /// total: the smallest is at least 4 times the determinant over the square of the trace.
    bool is_plainly_solid(double share) const {
        const auto& s = matrix_;
        const double determinant = s[0][0] * (s[1][1] * s[2][2] - s[1][2] * s[2][1]) -
                                   s[0][1] * (s[1][0] * s[2][2] - s[1][2] * s[2][0]) +
                                   s[0][2] * (s[1][0] * s[2][1] - s[1][1] * s[2][0]);
        return 4.0 * determinant > share * total() * total() * total();
    }

    /// The axis along which there is least.
    ///
    /// Jacobi's method: each rotation takes away one of the numbers beside the diagonal, and each
    /// round squares what is left of them: five leave nothing.
    Axis flattest_axis() const {
        constexpr std::size_t ROUNDS = 6;
        double spread[3][3], axes[3][3] = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};
        std::copy_n(&matrix_[0][0], 9, &spread[0][0]);
        for (std::size_t turn = 0; turn < 3 * ROUNDS; ++turn) {
            const std::size_t p = turn % 3, q = (turn + 1) % 3;
            if (spread[p][q] == 0.0) {
                continue;
            }
            const double ratio = 0.5 * (spread[q][q] - spread[p][p]) / spread[p][q];
            const double size = 1.0 / (std::abs(ratio) + std::sqrt(ratio * ratio + 1.0));
            const double tangent = ratio >= 0.0 ? size : -size;
            const double cosine = 1.0 / std::sqrt(tangent * tangent + 1.0), sine = tangent * cosine;
            const auto rotate = [&](double& a, double& b) {
                const double before = a;
                a = cosine * before - sine * b;
                b = sine * before + cosine * b;
            };
            for (std::size_t i = 0; i < 3; ++i) {
                rotate(spread[p][i], spread[q][i]);
            }
            for (std::size_t i = 0; i < 3; ++i) {
                rotate(spread[i][p], spread[i][q]);
                rotate(axes[i][p], axes[i][q]);
            }
            spread[p][q] = spread[q][p] = 0.0;
        }
        std::size_t least = 0;
        for (std::size_t i = 1; i < 3; ++i) {
            least = spread[i][i] < spread[least][least] ? i : least;
        }
        return {{axes[0][least], axes[1][least], axes[2][least]}, spread[least][least]};
    }

  private:
    double matrix_[3][3] = {};
};

}  // namespace lfnav::LFNAV_LEVEL
