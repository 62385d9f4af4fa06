"""A COLMAP model with its photos as a source of ``lfnav import``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipelines.artifacts.errors import InputError, quoted
from pipelines.dataset.dataset import natural_key
from pipelines.dataset.importers.recognition import find_colmap_models
from pipelines.dataset.importers.recording import (
    IMAGE_FOLDER,
    Recording,
    SourceFrame,
    first_duplicate,
    name_below,
)
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.dataset.importers.source_files import (
    NamedFile,
    all_inside,
    check_missing,
    files_below,
)
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.colmap_model import ColmapModel, ModelImage
from pipelines.reconstruct.colmap_text import image_count, read_any_model
from pipelines.reconstruct.connectivity import restrict

PHOTO_FOLDER = "images"
NAMED_MODELS = 5


@dataclass(frozen=True)
class ColmapSource:
    """A model, its registered images in natural order of their names, and where they lie."""

    model: ColmapModel
    images: tuple[ModelImage, ...]
    recording: Recording


def read_colmap(source: Path, settings: ImportSettings) -> ColmapSource:
    """Reads a model and finds the photo of each registered image.

    Args:
        source: the folder of a project (``images/`` and ``sparse/``), or of the model itself. Of
            several models the one with the most images is taken.
        settings: ``images`` where the photos lie elsewhere; ``allow_missing``.

    Raises:
        InputError: no model, a damaged one, one with camera models that lfnav does not know, or
            more photos that are gone than may be; the first missing one is named.
    """
    folder, notes = _largest_model(source)
    model = read_any_model(folder)
    if not model.images:
        raise InputError(folder, "holds no registered image")
    texts = [image.name for image in model.images]
    photos, files = _photo_files(source, folder, settings.images, texts)
    remedy = "" if settings.images else "name the folder of the photos with --images; "
    notes += check_missing(photos, files, settings.allow_missing, remedy)
    there = [row for row, file in enumerate(files) if file.is_there]
    if len(there) < len(files):
        model = restrict(model, there)
    double = first_duplicate([files[row].name for row in there])
    if double is not None:
        raise InputError(folder, f"holds the image {quoted(double)} twice")
    by_name = {files[row].name: image for row, image in zip(there, model.images, strict=True)}
    ordered = sorted(by_name, key=natural_key)
    images = tuple(by_name[name] for name in ordered)
    numbers = {number: row for row, number in enumerate(sorted({im.camera for im in images}))}
    frames = tuple(
        SourceFrame(
            photos / name,
            name_below(IMAGE_FOLDER, name, folder),
            float(row),
            camera=numbers[image.camera],
        )
        for row, (name, image) in enumerate(zip(ordered, images, strict=True))
    )
    cameras = tuple(model.cameras[number] for number in numbers)
    poses = inverse(np.array([image.camera_from_world for image in images]))
    recording = Recording(frames, cameras, poses, notes=notes)
    return ColmapSource(model, images, recording)


def _largest_model(source: Path) -> tuple[Path, tuple[str, ...]]:
    """COLMAP leaves several models where it could not join them into one."""
    models = find_colmap_models(source)
    if not models:
        raise InputError(
            source,
            "holds no COLMAP model (cameras.bin or cameras.txt, here, in sparse/ or in sparse/0)",
            "give the folder of the model",
        )
    if len(models) == 1:
        return models[0], ()
    counts = {folder: image_count(folder) for folder in models}
    largest = max(models, key=lambda folder: counts[folder])
    others = [f"{folder.name} ({counts[folder]})" for folder in models if folder != largest]
    more = ", …" if len(others) > NAMED_MODELS else ""
    return largest, (
        f"model {largest.name} of {len(models)} is taken, the one with the most photos "
        f"({counts[largest]}); left out: {', '.join(others[:NAMED_MODELS])}{more}",
    )


def _photo_files(
    source: Path, model: Path, given: Path | None, texts: list[str]
) -> tuple[Path, list[NamedFile]]:
    """The folder of the photos, and which of its files each name means."""
    if given is not None:
        if not given.is_dir():
            raise InputError(given, "is not a folder" if given.exists() else "does not exist")
        return given, all_inside(texts, files_below(given, texts), model)
    roots = [source, model.absolute().parent]
    if roots[1].name == "sparse":
        roots.append(roots[1].parent)
    # Names begin with images/ where COLMAP was given the folder above it.
    candidates = [*(root / PHOTO_FOLDER for root in roots), *roots]
    found = [(folder, files_below(folder, texts)) for folder in candidates if folder.is_dir()]

    def there(files: list[NamedFile | None]) -> int:
        return sum(file is not None and file.is_there for file in files)

    photos, files = max(found, key=lambda item: there(item[1]))
    if not there(files) and photos.name != PHOTO_FOLDER:
        raise InputError(
            source,
            f"holds no folder {PHOTO_FOLDER}/ with the photos of the model",
            "name it with --images",
        )
    return photos, all_inside(texts, files, model)
