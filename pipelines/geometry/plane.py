"""Planes in world coordinates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.arrays import FloatArray, checked_array
from pipelines.artifacts.errors import OptionError
from pipelines.geometry.camera import Intrinsics


@dataclass(frozen=True)
class Plane:
    """The points x with ``normal . x + offset = 0``.

    Attributes:
        normal: ``(3,)`` unit normal in world coordinates; it points to the side from which the
            surface is seen.
        offset: metres; the signed distance of the world's origin from the plane.

    Raises:
        OptionError: a normal that is not three finite numbers, or an offset that is not finite.
    """

    normal: FloatArray
    offset: float

    def __post_init__(self) -> None:
        checked_array(self.normal, "the plane's normal", (3,))
        checked_array(self.offset, "the plane's offset", ())

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        """How far points are from the plane.

        Args:
            points: ``(..., 3)`` world coordinates, metres.

        Returns:
            ``(...)`` metres, positive on the side from which the surface is seen.

        Raises:
            OptionError: no array of this shape.
        """
        places = checked_array(points, "points", (..., 3), finite=False)
        with np.errstate(invalid="ignore"):
            return np.asarray(places @ self.normal + self.offset)

    def facing(self, points: FloatArray) -> "Plane":
        """The same plane with its normal towards the majority of points.

        Args:
            points: ``(N, 3)`` world coordinates, metres; at least one.

        Raises:
            OptionError: no such array.
        """
        if len(checked_array(points, "points", (None, 3))) == 0:
            raise OptionError("a plane faces the majority of points, and there are none")
        if np.median(self.signed_distance(points)) < 0.0:
            return Plane(-self.normal, -self.offset)
        return self

    def coefficients(self) -> FloatArray:
        """``(4,)``: a, b, c, d of ``a x + b y + c z + d = 0`` with a unit normal."""
        return np.append(self.normal, self.offset)


def plane_from_coefficients(coefficients: ArrayLike) -> Plane:
    """The plane ``a x + b y + c z + d = 0``, normalised.

    Args:
        coefficients: ``(4,)``: a, b, c without a unit and d in metres where (a, b, c) has length 1;
            it points to the side from which the surface is seen.

    Raises:
        OptionError: not four finite numbers, or (a, b, c) is zero.
    """
    try:
        values = checked_array(coefficients, "a plane", (4,))
    except OptionError as error:
        raise OptionError(
            f"a plane takes four finite numbers a,b,c,d with a x + b y + c z + d = 0 ({error})"
        ) from error
    length = float(np.linalg.norm(values[:3]))
    if length == 0.0:
        raise OptionError("the plane's normal (a, b, c) is zero; give a direction")
    return Plane(values[:3] / length, float(values[3] / length))


def angle_between(first: Plane, second: Plane) -> float:
    """Angle (radians, in [0, pi/2]) between two planes, whichever way their normals point."""
    cosine = abs(float(first.normal @ second.normal))
    return float(np.arccos(min(1.0, cosine)))


def plane_inverse_depth(
    plane: Plane, world_from_camera: FloatArray, intrinsics: Intrinsics
) -> FloatArray:
    """Inverse depth of a plane, ``(H, W)``; 0 where the pixel does not show its seen side.

    With the pixel's viewing ray r = R K^-1 p, scaled to 1 along the optical axis, and the virtual
    centre's distance h from the plane, the inverse depth is -(n . r) / h.
    """
    columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
    height = float(plane.signed_distance(world_from_camera[:3, 3]))
    if height <= 0.0:
        return np.zeros(rows.shape)
    rays = world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix())
    return np.maximum(-(pixels @ (plane.normal @ rays)) / height, 0.0)
