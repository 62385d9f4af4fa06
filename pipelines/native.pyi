"""The C++ core (``native/``): what is done for every pixel of every particle.

Functions release the interpreter lock, change none of their arguments, and check them: an array of
another type, shape or order of elements than described is a ``TypeError`` or ``ValueError`` whose
one line names the argument. Arrays have to be in C order. Results do not depend on threads.

Images to be compared are ``(H, W, 4)``, float32: three channels in grey levels, and 1 where there
is something to compare, 0 where not.
"""

from pipelines.artifacts.array_types import BoolArray, Float32Array, FloatArray

def instruction_set() -> str:
    """Name of the processor's level, of those that the core is compiled for.

    ``x86-64-v3`` or ``x86-64-v4``, or ``baseline`` for what every processor can do.
    """

def fitted_brightness(
    view: Float32Array,
    target: Float32Array,
    stride: int,
    cutoff: float,
    smallest_scale: float,
    largest_gain: float,
) -> tuple[float, float, float]:
    """Gain and offset that take a rendered view to the camera image, outliers apart.

    Iteratively reweighted least squares with Tukey's biweight.

    Args:
        view: (H, W, 4) rendered, and 1 where covered.
        target: (H, W, 4) camera image, and 1 where it is to be compared.
        stride: only every so many-th pixel of every so many-th row is used.
        cutoff: errors beyond so many standard deviations count as something else.
        smallest_scale: of the errors, grey levels; their standard deviation is at least this.
        largest_gain: the gain stays between this and its inverse.

    Returns:
        Gain, offset and the standard deviation of what remains, estimated robustly; grey levels.
    """

def robust_error(
    view: Float32Array, target: Float32Array, gain: float, offset: float, limit: float
) -> float:
    """Mean of Tukey's loss over all pixels, squared grey levels; an uncovered one costs the most.

    Args:
        view: (H, W, 4) rendered, and 1 where covered.
        target: (H, W, 4) camera image, and 1 where it is to be compared.
        gain: factor on the rendered view.
        offset: added to it, grey levels.
        limit: error beyond which a pixel counts as something else, grey levels.
    """

def normal_equations(
    image: Float32Array,
    inverse_depth: Float32Array,
    target: Float32Array,
    gain: float,
    offset: float,
    limit: float,
    flat: float,
    intrinsics: FloatArray,
    rotation: FloatArray,
    lever: FloatArray,
    axes: FloatArray,
    is_rotation: BoolArray,
    tiles_across: int,
) -> tuple[FloatArray, FloatArray]:
    """The weighted normal equations of one comparison, with gain and offset as two more unknowns.

    A surface point at offset Y from the camera's centre, in its axes, moves by
    -R^T (dp + w x (X - p)) when the body at p is shifted by dp and rotated by w; divided by its
    depth this stays finite for points far away. Its colour is taken to move along. A pixel counts
    where it and its four neighbours are covered; what other pixels hold changes nothing.

    Args:
        image: (H, W, 4) rendered, and 1 where covered.
        inverse_depth: (H, W) of the surface.
        target: (H, W, 4) camera image, and 1 where it is to be compared.
        gain: factor on the rendered view.
        offset: added to it, grey levels.
        limit: error beyond which a pixel counts as something else, grey levels.
        flat: a pixel whose neighbours differ by less than so many grey levels does not count.
        intrinsics: (4,) fx, fy, cx, cy.
        rotation: (3, 3) of world_from_camera.
        lever: (3,) from the body's origin to the camera's centre, world axes.
        axes: (D, 3) world axis of each unknown, at most six.
        is_rotation: (D,) whether the unknown is a rotation about its axis, or a shift along it.
        tiles_across: the image's gradients are kept apart for so many times so many tiles.

    Returns:
        The Hessian (D + 2, D + 2), whose last two unknowns are gain and offset, and the gradient of
        each tile (tiles, D + 2).
    """
