"""Pose matrices from files: rigid, or refused."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, reason_of
from pipelines.geometry.pose import pose_from_rotation

# Matrices are written with six to eight digits and have been multiplied many times before; a
# scale or shear that somebody meant is larger.
RIGID_TOLERANCE = 0.01


def rigid_pose(path: Path, values: ArrayLike, label: str) -> FloatArray:
    """A pose from the 12 or 16 numbers of a ``(3, 4)`` or ``(4, 4)`` matrix.

    Args:
        path: the file that holds it.
        values: the matrix.
        label: which one it is, for the error.

    Returns:
        ``(4, 4)``; its rotation is the orthonormal matrix nearest to the given one.

    Raises:
        InputError: another shape, numbers that are not finite, a matrix that is singular, mirrors,
            or scales and shears.
    """
    try:
        matrix = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(path, f"{label} is no matrix of numbers") from error
    if matrix.shape not in ((3, 4), (4, 4)):
        raise InputError(path, f"{label} has shape {matrix.shape} instead of 4x4 or 3x4")
    if not np.all(np.isfinite(matrix)) or np.abs(matrix).max() > 1e12:
        raise InputError(path, f"{label} holds a number that is not finite, or huge")
    if len(matrix) == 4 and not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], atol=1e-6):
        raise InputError(path, f"the last row of {label} is not 0 0 0 1")
    rotation = matrix[:3, :3]
    determinant = float(np.linalg.det(rotation))
    if abs(determinant) < 1e-6:
        raise InputError(path, f"{label} is singular (determinant {determinant:.3g})")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > RIGID_TOLERANCE:
        raise InputError(
            path, f"{label} is not rigid: it scales or shears (determinant {determinant:.3g})"
        )
    if determinant < 0.0:
        raise InputError(path, f"{label} mirrors (determinant {determinant:.3g})")
    left, _, right = np.linalg.svd(rotation)
    return pose_from_rotation(left @ right, matrix[:3, 3])


def read_number_rows(path: Path, text: str, columns: int) -> FloatArray:
    """A text of lines of ``columns`` finite numbers each, as ``(N, columns)``.

    Raises:
        InputError: another number of values, or what is no finite number; the line is named.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        parts = line.split()
        if not parts:
            continue
        if len(parts) != columns:
            raise InputError(path, f"line {number}: {len(parts)} values instead of {columns}")
        try:
            rows.append([float(part) for part in parts])
        except ValueError as error:
            raise InputError(path, f"line {number}: not a number ({reason_of(error)})") from error
        if not np.all(np.isfinite(rows[-1])):
            raise InputError(path, f"line {number}: a value is not finite")
    return np.array(rows, dtype=np.float64).reshape(-1, columns)
