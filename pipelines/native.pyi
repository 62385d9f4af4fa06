"""The C++ core (``native/``): what is computed for every pixel of every particle.

Functions release the interpreter lock, change none of their arguments, and check them: an array of
another type, shape or order of elements than described is a ``TypeError`` or ``ValueError`` whose
one line names the argument. Arrays have to be in C order. Results do not depend on threads.
Functions of many arguments take them by name.

Images to be compared are ``(H, W, 4)``, float32: three channels in grey levels, and 1 where there
is something to compare, 0 where not.
"""

from collections.abc import Sequence

from pipelines.artifacts.arrays import (
    BoolArray,
    Float32Array,
    FloatArray,
    ImageArray,
    Int32Array,
    IntArray,
)

def instruction_set() -> str:
    """Name of the instruction set in use, of those that the core is compiled for.

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
        cutoff: errors beyond so many standard deviations are outliers.
        smallest_scale: least standard deviation of the errors, grey levels.
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
        limit: error beyond which a pixel is an outlier, grey levels.
    """

def normal_equations(
    *,
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
        limit: error beyond which a pixel is an outlier, grey levels.
        flat: a pixel whose neighbours differ by less than so many grey levels does not count.
        intrinsics: (4,) fx, fy, cx, cy.
        rotation: (3, 3) of world_from_camera.
        lever: (3,) from the body's origin to the camera's centre, world axes.
        axes: (D, 3) world axis of each unknown, at most six.
        is_rotation: (D,) whether the unknown is a rotation about its axis, or a shift along it.
        tiles_across: gradients are summed over each of so many by so many tiles of the image.

    Returns:
        The Hessian (D + 2, D + 2), whose last two unknowns are gain and offset, and the gradient of
        each tile (tiles, D + 2).
    """

def image_cost(
    *,
    view: Float32Array,
    query: Float32Array,
    cost: int,
    fit_gain: bool,
    limits: FloatArray,
    uncovered: FloatArray,
    table: Float32Array,
    evidence_bin: float,
) -> float:
    """The cost of a rendered view (``comparison.compare``).

    Args:
        view: (H, W, 4) rendered, and 1 where covered.
        query: (H, W, 4) camera image; its fourth number is 0 where it is not to be compared, else
            1, or for EVIDENCE 1 plus the pixel's row of the table.
        cost: a ``Cost``.
        fit_gain: whether a brightness factor is fitted.
        limits: (3,) of absolute differences, of differences of gradients, of the gain.
        uncovered: (4,) cost of an uncovered pixel, for each cost but EVIDENCE.
        table: (rows, bins) for EVIDENCE, its first row zeros; for other costs (0, bins).
        evidence_bin: width of a bin of the table, grey levels.
    """

def delaunay_triangles(points: FloatArray, smallest_area: float) -> Int32Array:
    """Delaunay triangulation of distinct points.

    Args:
        points: (N, 2).
        smallest_area: a triangle whose area is less than this share of the square of its longest
            side counts as a line.

    Returns:
        (t, 3) vertices of the triangles, counter-clockwise where y points up; and for each edge of
        the hull, with the outside on its right, two vertices and -1. Empty where all points lie on
        a line.
    """

def delaunay_meshes(
    *,
    poses: FloatArray,
    intrinsics: FloatArray,
    width: int,
    height: int,
    centres: FloatArray,
    takes_part: BoolArray,
    limits: FloatArray,
) -> tuple[Int32Array, Float32Array, Int32Array, int]:
    """Delaunay meshes of recording centres in virtual images (``render.delaunay_mesh``).

    Args:
        poses: (B, 4, 4) world_from_camera.
        intrinsics: (4,) fx, fy, cx, cy.
        width: width of the images, pixels.
        height: height of the images, pixels.
        centres: (N, 3) recording centres.
        takes_part: (B, N) which of them are in each mesh.
        limits: (4,) ``MESH_LIMITS``.

    Returns:
        Photos (B, R, 3) of up to R regions of each image, -1: none; their weights (B, R, 3, 4), as
        coefficients of x, y, 1 and x y from the image's middle; the region of each pixel
        (B, H, W), -1 where there is no mesh; and the number of regions of the mesh that has most.
    """

def plane_sweep(
    reference: ImageArray,
    photos: Sequence[ImageArray],
    maps: FloatArray,
    inverse_depths: FloatArray,
    best: int,
    saturation: float,
) -> ImageArray:
    """The cost volume of a plane sweep: how much photos disagree at each of many depths.

    Windows of 3 x 3 pixels, less the grey of their centres, are compared.

    Args:
        reference: (H, W) grey.
        photos: V of (h, w), grey, of any sizes.
        maps: (V, 3, 4) transfers M: the reference's pixel (x, y) at inverse depth q lies at the
            photo's homogeneous pixel M (x, y, 1, q).
        inverse_depths: (D,) of the planes, 1 / metres.
        best: a pixel's cost is the mean of so many of its lowest ones.
        saturation: grey levels; larger differences all cost the same.

    Returns:
        (H, W, D) costs, 0 (alike) to 240. A plane on which no photo shows the pixel has the mean of
        the others.
    """

def semi_global_matching(
    volume: ImageArray,
    reference: ImageArray,
    step_penalty: float,
    jump_penalty: float,
    edge_contrast: float,
    least_jump: float,
) -> tuple[Float32Array, Float32Array]:
    """The plane of each pixel, smooth except across edges of the image: eight paths, winner.

    Args:
        volume: (H, W, D) costs of D planes.
        reference: (H, W) grey.
        step_penalty: cost of neighbouring pixels that lie one plane apart, at most a million.
        jump_penalty: cost of neighbouring pixels that lie further apart, at most a million.
        edge_contrast: grey levels between neighbours at which a jump costs half.
        least_jump: a jump costs at least this.

    Returns:
        (H, W) numbers of the planes, with a fraction; and (H, W) how much less than the average
        plane the nearest one costs.
    """

def fuse_depth(
    inverse_depth: Float32Array,
    others: Sequence[Float32Array],
    confident: Sequence[BoolArray],
    to_view: FloatArray,
    from_view: FloatArray,
    unsure_trust: float,
    agreement: float,
) -> tuple[Float32Array, Float32Array]:
    """The depth at each pixel that most neighbours see and fewest see through.

    Args:
        inverse_depth: (H, W) of the view; 0, as in all maps: unknown.
        others: V of (h, w): inverse depths that neighbours found.
        confident: V of (h, w): where they are reliable.
        to_view: (V, 3, 4) transfers M: a neighbour's pixel (x, y) at inverse depth q lies at the
            view's homogeneous pixel M (x, y, 1, q).
        from_view: (V, 3, 4) transfers from the view's pixels to the neighbours'.
        unsure_trust: weight of a neighbour's depth where it is not reliable; else 1.
        agreement: share of the inverse depth within which depths are of the same surface.

    Returns:
        (H, W) means of all depths that agree with the best; and (H, W) neighbours that see the best
        less those that see through it.
    """

def log_mixture_density(
    positions: FloatArray,
    centres: FloatArray,
    angles: FloatArray,
    log_weights: FloatArray,
    position_sigma: float,
    angle_sigma: float,
) -> FloatArray:
    """Logarithm of a sum of isotropic normal distributions, but for their common factor.

    Args:
        positions: (M, P) positions, metres.
        centres: (N, P) of the distributions.
        angles: (M, N) between the orientations of both, radians.
        log_weights: (N,) of the distributions; -inf is a weight of 0.
        position_sigma: standard deviation along each axis, metres.
        angle_sigma: standard deviation of the angle, radians.

    Returns:
        (M,); -inf where all weights are 0.
    """

class LightField:
    """A light field, rendered over a plane or depth maps.

    Keeps its arrays, which are checked once; their content must not be changed. The arrays of the
    photos are described in ``lightfield.views.ViewArrays``, those of the index of the usable photos
    in ``render.candidate_views.ViewIndex``, the limits of surface and blending in
    ``render.surface`` and ``render.blending``.

    Args:
        texels: (T, 4) RGB and 255 of all photos' pyramids.
        level_start: (N, L) first texel of each level.
        level_size: (N, L, 2) width and height of each level.
        projection: (N, 3, 4) world points to homogeneous pixels.
        rays: (N, 3, 3) homogeneous pixels to world directions.
        centres: (N, 3) recording centres.
        focal: (N,) mean focal lengths, pixels.
        inverse_depth: (D,) all depth maps.
        depth_start: (N,) first value of each depth map.
        depth_size: (N, 2) width and height of each depth map.
        pooled_depth: (B,) max-pooled depth maps.
        pooled_start: (N,) first value of each pooled depth map.
        usable: (N,) photos that may take part.
        origin: (3,) local origin of the index.
        order: (S,) photos of the index.
        numbers: (18 S,) projection, centre and size of each.
        members: (16 G,) positions in ``order`` of each group's photos.
        blocks: (18 * 16 G,) ``numbers``, group by group.
        groups: (20 G,) sphere and frustum of each group.
        plane: (4,) unit normal and offset.
        depth_settings: (5,) pinhole factor, pinhole neighbours, edge factor, largest gap as a share
            of the grid, occlusion factor.
        penalties: (4,) of resolution and border, the smallest margin, the smallest penalty.
        most_ranked: of more photos than these candidates are selected before they are ranked.
        smallest_weight: below this sum of weights the blended photos do not show a pixel.
        has_mesh: whether photos are blended by the Delaunay mesh of their centres; else as an
            unstructured lumigraph.
        mesh: (4,) ``MESH_LIMITS``.
    """

    def __init__(
        self,
        *,
        texels: ImageArray,
        level_start: IntArray,
        level_size: IntArray,
        projection: FloatArray,
        rays: FloatArray,
        centres: FloatArray,
        focal: FloatArray,
        inverse_depth: Float32Array,
        depth_start: IntArray,
        depth_size: IntArray,
        pooled_depth: Float32Array,
        pooled_start: IntArray,
        usable: BoolArray,
        origin: FloatArray,
        order: Int32Array,
        numbers: Float32Array,
        members: Int32Array,
        blocks: Float32Array,
        groups: Float32Array,
        plane: FloatArray,
        depth_settings: FloatArray,
        penalties: FloatArray,
        most_ranked: int,
        smallest_weight: float,
        has_mesh: bool,
        mesh: FloatArray,
    ) -> None: ...
    def sources(
        self, poses: FloatArray, usual_inverse_depth: float, turn_cost: float, most: int
    ) -> Int32Array:
        """Chooses the photos nearest to virtual cameras that have depth maps.

        Args:
            poses: (B, 4, 4) world_from_camera.
            usual_inverse_depth: median of all depth maps' known values, 1 / metres.
            turn_cost: cost of a rotation by a radian, in median depths.
            most: the most photos.

        Returns:
            (B, most) photos, -1 after the last.
        """

    def views(
        self,
        *,
        poses: FloatArray,
        intrinsics: FloatArray,
        across: IntArray,
        down: IntArray,
        probes_across: IntArray,
        probes_down: IntArray,
        frustum_across: IntArray,
        frustum_down: IntArray,
        pixels: Int32Array,
        width: int,
        height: int,
        samples: tuple[Float32Array, Float32Array, IntArray, IntArray] | None,
        sources: Int32Array,
        spacing: float,
    ) -> VirtualViews:
        """Some pixels of virtual views, which can be rendered, and compared with an image.

        Args:
            poses: (B, 4, 4) world_from_camera.
            intrinsics: (4,) or more: fx, fy, cx, cy.
            across: columns of the tiles' corners.
            down: rows of the tiles' corners.
            probes_across: (4,) columns of the points at which candidate photos are selected.
            probes_down: (4,) rows of these points.
            frustum_across: columns of the points one of which each photo of a mesh has to see.
            frustum_down: rows of these points.
            pixels: (P,) indices in the image, rising.
            width: width of the image, pixels.
            height: height of the image, pixels.
            samples: of depth maps of this light field, ``render.depth_samples.DepthSamples``; None:
                the surface is the plane.
            sources: (B, S) photos whose depth maps make the surface; -1 after the last.
            spacing: of the depth grid's vertices, at least 1 pixel.
        """

class VirtualViews:
    """P pixels of B virtual views; ``LightField.views`` makes them."""

    def render(self) -> tuple[Float32Array, Float32Array]:
        """Renders them.

        Returns:
            (B, P, 4) RGB, 0 to 255, and 1 where any photo shows the pixel, all zero elsewhere; and
            (B, P) inverse depths.
        """

    def costs(
        self,
        *,
        query: Float32Array,
        cost: int,
        fit_gain: bool,
        limits: FloatArray,
        uncovered: FloatArray,
        table: Float32Array,
        evidence_bin: float,
    ) -> FloatArray:
        """Renders them and compares them with a camera image.

        Args:
            query: (h, w, 4) the same P = h w pixels of a camera image; the fourth number is 0 where
                it is not to be compared, else 1, or for EVIDENCE 1 plus the row of the table.
            cost: a ``Cost``.
            fit_gain: whether a brightness factor is fitted for each view.
            limits: (3,) of absolute differences, of differences of gradients, of the gain.
            uncovered: (4,) cost of an uncovered pixel, for each cost but EVIDENCE.
            table: (rows, bins) for EVIDENCE, its first row zeros; for other costs (0, bins).
            evidence_bin: width of a bin of the table, grey levels.

        Returns:
            (B,) costs.
        """
