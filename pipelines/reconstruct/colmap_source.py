"""A COLMAP model with its photos as a source of ``lfnav import``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.errors import InputError, quoted
from pipelines.artifacts.file_content import is_file
from pipelines.dataset.dataset import natural_key
from pipelines.dataset.importers.recognition import find_colmap_model
from pipelines.dataset.importers.recording import (
    IMAGE_FOLDER,
    Recording,
    SourceFrame,
    first_duplicate,
    name_below,
)
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.colmap_model import ColmapModel, ModelImage
from pipelines.reconstruct.colmap_text import read_any_model

PHOTO_FOLDER = "images"


@dataclass(frozen=True)
class ColmapSource:
    """A model, its registered images in natural order of their names, and where they lie."""

    model: ColmapModel
    images: tuple[ModelImage, ...]
    recording: Recording


def read_colmap(source: Path, settings: ImportSettings) -> ColmapSource:
    """Reads a model and finds the photo of each registered image.

    Args:
        source: the folder of a project (``images/`` and ``sparse/``), or of the model itself.
        settings: ``images`` where the photos lie elsewhere.

    Raises:
        InputError: no model, a damaged one, one with camera models that lfnav does not know, or
            photos that are gone; the first missing one is named.
    """
    folder = find_colmap_model(source)
    if folder is None:
        raise InputError(
            source,
            "holds no COLMAP model (cameras.bin or cameras.txt, here, in sparse/ or in sparse/0)",
            "give the folder of the model",
        )
    notes = _other_models(folder)
    model = read_any_model(folder)
    images = tuple(sorted(model.images, key=lambda image: natural_key(image.name)))
    if not images:
        raise InputError(folder, "holds no registered image")
    double = first_duplicate([image.name for image in images])
    if double is not None:
        raise InputError(folder, f"holds the image {quoted(double)} twice")
    names = [name_below(IMAGE_FOLDER, image.name, folder) for image in images]
    photos = _photo_folder(source, folder, settings.images)
    files = [photos / image.name for image in images]
    missing = [file for file in files if not is_file(file)]
    if missing:
        raise InputError(
            missing[0],
            f"is not there, but the model has a pose for it ({len(missing)} of {len(files)} "
            "photos are missing)",
            "name the folder of the photos with --images",
        )
    used = {image.camera for image in images}
    numbers = {number: row for row, number in enumerate(sorted(used))}
    frames = tuple(
        SourceFrame(file, name, float(row), camera=numbers[image.camera])
        for row, (file, name, image) in enumerate(zip(files, names, images, strict=True))
    )
    cameras = tuple(model.cameras[number] for number in numbers)
    poses = inverse(np.array([image.camera_from_world for image in images]))
    recording = Recording(frames, cameras, poses, notes=notes)
    return ColmapSource(model, images, recording)


def _other_models(folder: Path) -> tuple[str, ...]:
    """COLMAP numbers the models of a project where it could not join them into one."""
    if folder.name != "0":
        return ()
    others = sorted(
        path.name
        for path in folder.parent.iterdir()
        if path.name.isdigit() and path.is_dir() and path != folder
    )
    if not others:
        return ()
    return (f"model 0 of several; the others ({', '.join(others[:5])}) are left out",)


def _photo_folder(source: Path, model: Path, given: Path | None) -> Path:
    if given is not None:
        if not given.is_dir():
            raise InputError(given, "is not a folder" if given.exists() else "does not exist")
        return given
    model = model.absolute()
    places = [source / PHOTO_FOLDER, model.parent / PHOTO_FOLDER]
    if model.parent.name == "sparse":
        places.append(model.parent.parent / PHOTO_FOLDER)
    for place in places:
        if place.is_dir():
            return place
    raise InputError(
        source,
        f"holds no folder {PHOTO_FOLDER}/ with the photos of the model",
        "name it with --images",
    )
