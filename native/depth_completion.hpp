// Depth where no neighbouring view confirms any: the surfaces around it are carried on.

#pragma once

#include "image.hpp"
#include "instruction_set.hpp"

namespace lfnav {

/// Gives pixels whose depth is not known that of the surfaces around them.
///
/// In eight directions the nearest known pixel is looked up, and the plane there carried on; the
/// result is the weighted median of what they say, nearer ones counting more.
///
/// @param known: (H, W) where the inverse depth can be relied on, and stays as it is.
/// @param completed: (H, W) receives inverse depths; a pixel from which no known one is found keeps
///     its own.
LFNAV_DECLARE(void complete_depth(const ScalarImage& inverse_depth, const bool* known,
                                  float* completed))

}  // namespace lfnav
