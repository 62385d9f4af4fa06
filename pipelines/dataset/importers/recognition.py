"""Which layout a source has, found out from what lies in it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import IMAGE_LIST, images_in, natural_key
from pipelines.dataset.importers.camera_grid import grid_files
from pipelines.dataset.importers.euroc import CAMERA, find_recording
from pipelines.dataset.importers.llff import POSES
from pipelines.dataset.importers.nerfstudio import find_transforms
from pipelines.dataset.importers.polycam import find_keyframes
from pipelines.dataset.importers.record3d import METADATA, is_record3d
from pipelines.dataset.importers.settings import KINDS
from pipelines.dataset.importers.seven_scenes import FRAME_NAME
from pipelines.dataset.left_out import VIDEO_SUFFIXES

# Where COLMAP's models lie in a project, one or several numbered ones.
MODEL_FOLDER = "sparse"
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


def find_colmap_models(source: Path) -> tuple[Path, ...]:
    """The folders of the COLMAP models in a project, several where they lie beside each other."""
    for folder in (source, source / MODEL_FOLDER):
        if _has_model(folder):
            return (folder,)
    for parent, is_model in ((source / MODEL_FOLDER, bool), (source, str.isdecimal)):
        if parent.is_dir():
            names = [p.name for p in parent.iterdir() if is_model(p.name) and _has_model(p)]
            if names:
                return tuple(parent / name for name in sorted(names, key=natural_key))
    return ()


def _has_model(folder: Path) -> bool:
    return any((folder / file).is_file() for file in MODEL_FILES)


def _nerfstudio_sign(source: Path) -> str | None:
    path = find_transforms(source)
    return None if path is None else path.name


def _colmap_sign(source: Path) -> str | None:
    models = find_colmap_models(source) if source.is_dir() else ()
    if not models:
        return None
    model = models[0]
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


def _euroc_sign(source: Path) -> str | None:
    folder = find_recording(source)
    return None if folder is None else f"{(folder / CAMERA).relative_to(source).as_posix()}/"


def _record3d_sign(source: Path) -> str | None:
    return METADATA if is_record3d(source) else None


def _polycam_sign(source: Path) -> str | None:
    found = find_keyframes(source)
    return None if found is None else f"{found[1].relative_to(source).as_posix()}/"


def _llff_sign(source: Path) -> str | None:
    return POSES if (source / POSES).is_file() else None


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
    "euroc": _euroc_sign,
    "record3d": _record3d_sign,
    "polycam": _polycam_sign,
    "llff": _llff_sign,
    "grid": _grid_sign,
    "video": _video_sign,
}
