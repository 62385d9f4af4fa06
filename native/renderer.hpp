// Virtual views of a light field, over a plane or depth maps, blended by tiles or by the Delaunay
// mesh, and what they cost against a camera image. The readable version is
// pipelines/render/reference.py.

#pragma once

#include "instruction_set.hpp"
#include "virtual_views.hpp"

namespace lfnav {

/// Renders views.
///
/// @param images: (B, P, 4) receives colours, 0 to 255, and 1 where any photo shows the pixel; all
///     zero elsewhere.
/// @param inverse_depths: (B, P) receives the surface's, 1 / metres along the optical axis; 0:
/// none.
LFNAV_DECLARE(void render(const LightField& field, const VirtualViews& views, float* images,
                          float* inverse_depths))

/// Renders and compares views.
///
/// @param costs: (B,) receives the costs.
LFNAV_DECLARE(void compare_views(const LightField& field, const VirtualViews& views,
                                 const Comparison& comparison, double* costs))

/// What one rendered view costs.
///
/// @param view: 0 to 255, and 1 where covered, else 0; as large as the camera image.
LFNAV_DECLARE(double compare_image(const MaskedImage& view, const Comparison& comparison))

}  // namespace lfnav
