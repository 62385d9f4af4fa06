// The density of a mixture of normal distributions.

#pragma once

#include <cstddef>

#include "instruction_set.hpp"

namespace lfnav {

/// N isotropic normal distributions of positions and angles.
struct Mixture {
    std::size_t count, dimensions;
    /// (N, P) centres, and (N,) logarithms of weights; -infinity is a weight of 0.
    const double *centres, *log_weights;
    double position_sigma, angle_sigma;
};

/// Logarithms of the densities at places, but for the distributions' common factor.
///
/// @param places: how many, M.
/// @param positions: (M, P).
/// @param angles: (M, N) between the orientations there and those of the distributions, radians.
/// @param result: (M,) receives the logarithms; -infinity where all weights are 0.
LFNAV_DECLARE(void log_mixture_density(const Mixture& mixture, std::size_t places,
                                       const double* positions, const double* angles,
                                       double* result))

}  // namespace lfnav
