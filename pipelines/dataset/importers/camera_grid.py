"""A regular camera grid: the two-plane light field, a file for each row and column.

All cameras look the same way. The world that lfnav gives them: they look along +y; columns run
along +x, to the right; rows run along -z, down; the camera of row 0 and column 0 is the origin.
An index is a place on the grid, so where only even rows and columns are there, they are two
spacings apart.

Rectified archives often shift each image so that one plane of the scene lies still in all of them.
That is a principal point that moves with the camera: over a plane at distance F it moves by
``focal * position / F``. It is measured from the middle of the grid, where it is the image centre.
"""

import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, quoted
from pipelines.dataset.dataset import images_in
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.recording import (
    IMAGE_FOLDER,
    Recording,
    SourceFrame,
    name_below,
)
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import pose_from_rotation

DEFAULT_PATTERN = "r{row}_c{col}.*"
# Columns: the axes of the cameras (right, down, forward) in world coordinates.
WORLD_FROM_GRID_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

Cell = tuple[int, int]


def read_camera_grid(source: Path, settings: ImportSettings) -> Recording:
    """Reads a grid of images, rows from top to bottom.

    Args:
        source: the folder of the images, or the one above it.
        settings: ``spacing`` and one of ``focal`` and ``fov`` are needed.

    Raises:
        InputError: no file matches, two lie on one place, or places are empty.
        OptionError: spacing or focal length are not given, or the pattern has no row and column.
    """
    if settings.spacing is None:
        raise OptionError("a camera grid needs --spacing METRES, from one index to the next")
    files = grid_files(source, settings.pattern or DEFAULT_PATTERN)
    notes = _check_complete(source, files, settings.allow_missing)
    cells = sorted(files)
    header = read_image_header(files[cells[0]])
    focal = settings.focal_length(header.width)
    if focal is None:
        raise OptionError("a camera grid needs --focal PX or --fov DEG")
    positions = np.array(cells, dtype=np.float64)[:, ::-1] * settings.spacing  # right, down
    shifts = np.zeros((1, 2))
    if settings.focus is not None:
        middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
        shifts = focal * (positions - middle) / settings.focus
    centre = np.array([(header.width - 1) / 2.0, (header.height - 1) / 2.0])
    cameras = tuple(
        Camera("SIMPLE_PINHOLE", header.width, header.height, (focal, *(centre + shift).tolist()))
        for shift in shifts
    )
    frames = tuple(
        SourceFrame(
            files[cell],
            name_below(IMAGE_FOLDER, files[cell].name, source),
            float(index),
            camera=index if len(cameras) > 1 else 0,
        )
        for index, cell in enumerate(cells)
    )
    return Recording(frames, cameras, grid_poses(positions), notes=notes)


def grid_poses(positions: FloatArray) -> FloatArray:
    """world_from_camera ``(N, 4, 4)`` of cameras at ``(N, 2)`` metres to the right and down."""
    centres = np.column_stack([positions[:, 0], np.zeros(len(positions)), -positions[:, 1]])
    rotations = np.broadcast_to(WORLD_FROM_GRID_CAMERA, (len(positions), 3, 3))
    return pose_from_rotation(rotations, centres)


def grid_files(source: Path, pattern: str = DEFAULT_PATTERN) -> dict[Cell, Path]:
    """(row, column) -> image, of a folder or else of its one sub-folder that holds a grid.

    Raises:
        InputError: no file matches, files in several folders do, or two lie on one place.
        OptionError: the pattern lacks row or column.
    """
    expression = _expression(pattern)
    found = _matches(source, expression)
    if not found:
        folders = sorted(path for path in source.iterdir() if path.is_dir())
        inside = {folder: _matches(folder, expression) for folder in folders}
        filled = [folder for folder, files in inside.items() if files]
        if len(filled) > 1:
            names = ", ".join(folder.name for folder in filled[:5])
            raise InputError(source, f"holds grids in several folders ({names})", "give one")
        if not filled:
            raise InputError(
                source,
                f"holds no image whose name is of the form {pattern}",
                "say --pattern, with {row} and {col} where the numbers are",
            )
        found = inside[filled[0]]
    return found


def _expression(pattern: str) -> re.Pattern[str]:
    if pattern.count("{row}") != 1 or pattern.count("{col}") != 1 or "/" in pattern:
        raise OptionError(
            f"--pattern {quoted(pattern)} must be a file name with {{row}} and {{col}} once each"
        )
    parts = re.split(r"(\{row\}|\{col\}|\*)", pattern)
    pieces = {"{row}": "(?P<row>[0-9]{1,6})", "{col}": "(?P<col>[0-9]{1,6})", "*": ".*"}
    return re.compile("".join(pieces.get(part, re.escape(part)) for part in parts))


def _matches(folder: Path, expression: re.Pattern[str]) -> dict[Cell, Path]:
    files: dict[Cell, Path] = {}
    for name in images_in(folder):
        match = expression.fullmatch(name)
        if match is None:
            continue
        cell = (int(match["row"]), int(match["col"]))
        if cell in files:
            raise InputError(
                folder / name, f"is at the same place of the grid as {files[cell].name}"
            )
        files[cell] = folder / name
    return files


def _check_complete(
    source: Path, files: Mapping[Cell, Path], allow_missing: float | None
) -> tuple[str, ...]:
    """Notes about empty places of the grid that the indices span."""
    rows, columns = (_span([cell[axis] for cell in files]) for axis in (0, 1))
    expected = len(rows) * len(columns)
    missing = expected - len(files)
    if missing == 0:
        return ()
    text = f"{missing} of {expected} places of the grid ({len(rows)} rows, {len(columns)} columns)"
    if missing > (allow_missing or 0.0) * expected:
        # A lazy search: names from a stranger may span a trillion places.
        row, column = next(cell for cell in itertools.product(rows, columns) if cell not in files)
        raise InputError(
            source,
            f"holds no image for row {row}, column {column}; {text} are empty",
            "--allow-missing imports the others",
        )
    return (f"{text} are empty",)


def _span(indices: list[int]) -> range:
    """From the lowest to the highest index in steps of their greatest common divisor."""
    low = min(indices)
    step = math.gcd(*(index - low for index in indices)) or 1
    return range(low, max(indices) + 1, step)
