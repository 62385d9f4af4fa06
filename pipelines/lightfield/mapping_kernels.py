"""From virtual pixels into views: the mappings of ``reference.view_mappings``, compiled."""

from pipelines.artifacts.array_types import FloatArray, IntArray
from pipelines.lightfield.compiled import compiled_leaf


@compiled_leaf
def virtual_rays(pose: FloatArray, intrinsics: FloatArray, rays: FloatArray) -> None:
    """Writes the (3, 3) matrix R K^-1 from virtual pixels to world directions."""
    for i in range(3):
        x, y, z = pose[i, 0] / intrinsics[0], pose[i, 1] / intrinsics[1], pose[i, 2]
        rays[i, 0], rays[i, 1] = x, y
        rays[i, 2] = z - x * intrinsics[2] - y * intrinsics[3]


@compiled_leaf
def view_mapping(
    projection: FloatArray,
    view: int,
    pose: FloatArray,
    rays: FloatArray,
    maps: FloatArray,
    shifts: FloatArray,
) -> None:
    """Writes a view's map (3, 3) and shift (3,): pixel p at inverse depth d is map p + shift d."""
    for i in range(3):
        shifts[view, i] = projection[view, i, 3]
        for j in range(3):
            shifts[view, i] += projection[view, i, j] * pose[j, 3]
            maps[view, i, j] = (
                projection[view, i, 0] * rays[0, j]
                + projection[view, i, 1] * rays[1, j]
                + projection[view, i, 2] * rays[2, j]
            )


@compiled_leaf
def locate(
    x: float, y: float, inverse_depth: float, view: int, maps: FloatArray, shifts: FloatArray
) -> tuple[float, float, float]:
    """Column and row in a view of a virtual pixel's surface point, and its depth there.

    The depth is relative to the virtual one; it is 0 for points behind the view.
    """
    depth = (
        maps[view, 2, 0] * x
        + maps[view, 2, 1] * y
        + maps[view, 2, 2]
        + shifts[view, 2] * inverse_depth
    )
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    reciprocal = 1.0 / depth
    u = maps[view, 0, 0] * x + maps[view, 0, 1] * y + maps[view, 0, 2]
    v = maps[view, 1, 0] * x + maps[view, 1, 1] * y + maps[view, 1, 2]
    u += shifts[view, 0] * inverse_depth
    v += shifts[view, 1] * inverse_depth
    return u * reciprocal, v * reciprocal, depth


@compiled_leaf
def is_inside(level_size: IntArray, view: int, u: float, v: float) -> bool:
    """Whether a place lies inside a view's image."""
    return bool(
        -0.5 <= u <= level_size[view, 0, 0] - 0.5 and -0.5 <= v <= level_size[view, 0, 1] - 0.5
    )
