"""Which layout a source has, found out from what lies in it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import IMAGE_LIST, images_in
from pipelines.dataset.importers.camera_grid import grid_files
from pipelines.dataset.importers.nerfstudio import find_transforms
from pipelines.dataset.importers.settings import KINDS
from pipelines.dataset.importers.seven_scenes import FRAME_NAME
from pipelines.dataset.left_out import VIDEO_SUFFIXES

# Where a COLMAP model may lie in a project; "" is the project's folder itself.
MODEL_FOLDERS = ("", "sparse", "sparse/0", "0")
MODEL_FILES = ("cameras.bin", "cameras.txt")


@dataclass(frozen=True)
class Recognition:
    """What a source was taken for, and by what; ``others`` are kinds that it could also be."""

    kind: str
    evidence: str
    others: tuple[str, ...] = ()


def recognise(source: Path) -> Recognition:
    """The kind of a source.

    Raises:
        InputError: nothing is there, it is a data set already, or no kind fits.
    """
    if not source.exists():
        raise InputError(source, "does not exist")
    found = [
        (kind, evidence) for kind, look in _SIGNS.items() if (evidence := look(source)) is not None
    ]
    if found:
        (kind, evidence), *others = found
        return Recognition(kind, evidence, tuple(name for name, _ in others))
    if (source / IMAGE_LIST).is_file():
        raise InputError(source, "is a data set already", "use it as it is")
    raise InputError(
        source,
        f"is not recognised as any of {', '.join(KINDS)}",
        "say which with --from; a plain folder of images needs no import",
    )


def find_colmap_model(source: Path) -> Path | None:
    """The folder of the COLMAP model in a project; None where there is none."""
    for name in MODEL_FOLDERS:
        if any((source / name / file).is_file() for file in MODEL_FILES):
            return source / name
    return None


def _nerfstudio_sign(source: Path) -> str | None:
    path = find_transforms(source)
    return None if path is None else path.name


def _colmap_sign(source: Path) -> str | None:
    model = find_colmap_model(source) if source.is_dir() else None
    if model is None:
        return None
    name = next(name for name in MODEL_FILES if (model / name).is_file())
    return str((model / name).relative_to(source))


def _kitti_sign(source: Path) -> str | None:
    if (source / "sequences").is_dir():
        return "sequences/"
    is_sequence = (source / "calib.txt").is_file() and (source / "times.txt").is_file()
    return "calib.txt and times.txt" if is_sequence else None


def _seven_scenes_sign(source: Path) -> str | None:
    names = images_in(source) if source.is_dir() else ()
    return next((name for name in names if FRAME_NAME.fullmatch(name)), None)


def _grid_sign(source: Path) -> str | None:
    if not source.is_dir():
        return None
    try:
        files = grid_files(source)
    except InputError:
        return None
    return min(files.values()).name


def _video_sign(source: Path) -> str | None:
    is_video = source.is_file() and source.suffix.lower() in VIDEO_SUFFIXES
    return re.sub(r".*\.", "*.", source.name) if is_video else None


# In the order of trust: a folder with transforms.json often holds the COLMAP model it came from.
_SIGNS: dict[str, Callable[[Path], str | None]] = {
    "nerfstudio": _nerfstudio_sign,
    "colmap": _colmap_sign,
    "kitti": _kitti_sign,
    "7scenes": _seven_scenes_sign,
    "grid": _grid_sign,
    "video": _video_sign,
}
