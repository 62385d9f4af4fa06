// How errors of pixels are worked out and weighed.

#pragma once

namespace lfnav {

/// Brightness of a rendered view against a camera image, and what counts as an outlier.
struct Photometry {
    /// Factor on the rendered view, and what is added to it, grey levels.
    double gain, offset;
    /// Error beyond which a pixel counts as something else, grey levels.
    double limit;
};

}  // namespace lfnav
