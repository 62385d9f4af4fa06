"""Flat parts of a scene with exactly known geometry: their pixels in an image, and their depth.

A part is a rectangle in the world: a door leaf, a mirror, a window. The rectangles come from a file
that is written by hand, from a plan or a tape measure; nothing is estimated here.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.geometry.camera import Intrinsics

PART = "part"
KEYS = ("corner", "right", "up")


@dataclass(frozen=True)
class FlatPart:
    """A rectangle, or the back of a niche of the same outline.

    Attributes:
        corner: ``(3,)`` lower left corner as a viewer sees it, world coordinates, metres.
        right: ``(3,)`` vector from ``corner`` to the lower right corner, metres.
        up: ``(3,)`` vector from ``corner`` to the upper left corner, metres.
        recess: depth of the niche, metres; its side walls occlude the rectangle.
    """

    corner: FloatArray
    right: FloatArray
    up: FloatArray
    recess: float

    def inverse_depth(self, world_from_camera: FloatArray, intrinsics: Intrinsics) -> FloatArray:
        """Inverse depth ``(H, W)`` of the rectangle at the pixels that show it; 0 at others.

        Occlusion by anything but the niche is not considered.

        Args:
            world_from_camera: ``(4, 4)`` pose of the camera.
            intrinsics: of the camera.
        """
        normal = np.cross(self.right, self.up)
        normal = normal / np.linalg.norm(normal)
        centre = world_from_camera[:3, 3]
        distance = float(normal @ (centre - self.corner))
        columns, rows = np.meshgrid(np.arange(intrinsics.width), np.arange(intrinsics.height))
        if distance <= self.recess:
            return np.zeros(rows.shape)
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1)
        rays = pixels @ (world_from_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix())).T
        approach = -(rays @ normal)
        towards = approach > 0.0
        reach = 1.0 / np.where(towards, approach, np.inf)
        shown = towards
        for height in (distance, distance - self.recess):
            points = centre + (height * reach)[..., None] * rays - self.corner
            for side in (self.right, self.up):
                along = points @ side / float(side @ side)
                shown = shown & (along >= 0.0) & (along <= 1.0)
        return np.where(shown, approach / distance, 0.0)


def parts_inverse_depth(
    parts: Sequence[FlatPart], world_from_camera: FloatArray, intrinsics: Intrinsics
) -> FloatArray:
    """Inverse depth ``(H, W)`` of the nearest of several parts; 0 at pixels that show none.

    Args:
        parts: the rectangles.
        world_from_camera: ``(4, 4)`` pose of the camera.
        intrinsics: of the camera.
    """
    nearest = [part.inverse_depth(world_from_camera, intrinsics) for part in parts]
    return np.asarray(np.max(nearest, axis=0))


def read_flat_parts(path: Path) -> tuple[FlatPart, ...]:
    """Reads ``[[part]]`` tables of a TOML file: ``corner``, ``right``, ``up``, ``recess``.

    Raises:
        InputError: the file cannot be read or does not describe rectangles.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(path, f"cannot be read as TOML: {error}") from error
    tables = content.get(PART)
    if not isinstance(tables, list) or not tables:
        raise InputError(path, f"names no [[{PART}]]", f"give {', '.join(KEYS)} of each")
    return tuple(_part(path, number, table) for number, table in enumerate(tables, start=1))


def _part(path: Path, number: int, table: Any) -> FlatPart:
    """The rectangle of a table.

    Raises:
        InputError: the table does not describe one.
    """
    place = f"{PART} {number}"
    vectors = []
    for key in KEYS:
        value = table.get(key) if isinstance(table, dict) else None
        try:
            vector = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            vector = np.zeros(0)
        if vector.shape != (3,) or not np.all(np.isfinite(vector)):
            raise InputError(path, f"{place}: {key} is not three numbers")
        vectors.append(vector)
    corner, right, up = vectors
    recess = table.get("recess", 0.0)
    if not isinstance(recess, int | float) or not 0.0 <= recess < np.inf:
        raise InputError(path, f"{place}: recess is no depth in metres")
    lengths = np.linalg.norm(right) * np.linalg.norm(up)
    if lengths == 0.0 or abs(float(right @ up)) > 1e-6 * lengths:
        raise InputError(path, f"{place}: right and up are not the sides of a rectangle")
    return FlatPart(corner, right, up, float(recess))
