// The robust error of a rendered view against a camera image.

#pragma once

#include "image.hpp"
#include "instruction_set.hpp"
#include "photometry.hpp"

namespace lfnav {

/// Mean of Tukey's loss over all pixels, squared grey levels; an uncovered one costs the most.
///
/// @param view: rendered, and 1 where covered.
/// @param target: camera image, and 1 where it is to be compared.
LFNAV_DECLARE(double robust_error(const MaskedImage& view, const MaskedImage& target,
                                  const Photometry& photometry))

}  // namespace lfnav
