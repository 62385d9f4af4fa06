"""The study of view-dependent appearance from files to files."""

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from pipelines.artifacts.atomic import atomic_folder
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import load_dataset
from pipelines.experiments.flat_parts import FlatPart, read_flat_parts
from pipelines.experiments.view_dependence import (
    ViewDependence,
    measure,
    part_views,
    with_true_depth,
)
from pipelines.experiments.view_dependence_figure import markdown, write_figure
from pipelines.geometry.plane import Plane
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.views import Views, views_of_scene
from pipelines.render.held_out import HeldOut, photos_of_dataset, posed_photos, views_one_by_one

TABLE, FIGURE = "table.md", "view-dependence.png"

Photos = Callable[[Views], Iterator[HeldOut]]


def study_view_dependence(
    scene_path: Path,
    parts_path: Path,
    dataset: Path,
    output: Path,
    *,
    overwrite: bool,
    progress: Progress,
) -> tuple[ViewDependence, ...]:
    """Compares light field and texture on flat parts; writes a table and a figure.

    The photos are those of a data set, and the scene's own views, each left out once. (The depth
    maps of the other views were computed with the view that is left out.)

    Args:
        scene_path: scene model with depth maps.
        parts_path: TOML file of the parts, in the format of ``read_flat_parts``.
        dataset: data set of held-out photos with ground truth.
        output: folder for ``table.md`` and ``view-dependence.png``.
        overwrite: whether the output may be replaced.
        progress: wraps loops to report progress.

    Raises:
        InputError: a file cannot be read, or the output not be written.
        StageError: the scene has no depth maps or no plane, or no photo shows the parts.
    """
    parts = read_flat_parts(parts_path)
    scene = load_scene(scene_path)
    if not scene.depth:
        raise StageError(f"{scene_path} has no depth maps; make it with --geometry depth")
    if scene.surface is None:
        raise StageError(f"{scene_path} has no plane to compare with; make it with --plane a,b,c,d")
    frames, camera_poses = posed_photos(load_dataset(dataset), None)
    with atomic_folder(output, overwrite, TABLE) as folder:
        views = views_of_scene(scene, progress=progress)
        true_views = with_true_depth(views, scene.world_from_camera, parts)
        sets: dict[str, tuple[Photos, int]] = {
            dataset.name: (lambda of: photos_of_dataset(frames, camera_poses, of), len(frames)),
            "left out": (lambda of: _left_out(scene, of), len(scene)),
        }
        results = tuple(
            measure(name, photos(views), photos(true_views), count, scene.plane, parts, progress)
            for name, (photos, count) in sets.items()
        )
        (folder / TABLE).write_text(markdown(results), encoding="utf-8")
        photos, _ = sets[dataset.name]
        _draw(folder / FIGURE, results, photos, views, true_views, scene.plane, parts)
    return results


def _left_out(scene: Scene, views: Views) -> Iterator[HeldOut]:
    """The scene's own views, each with a light field that lacks it."""
    return views_one_by_one(scene, views, range(len(scene)))


def _draw(
    path: Path,
    results: tuple[ViewDependence, ...],
    photos: Photos,
    views: Views,
    true_views: Views,
    plane: Plane,
    parts: tuple[FlatPart, ...],
) -> None:
    """Writes the figure with the photo of the first set whose PSNR is the median."""
    quality = results[0].psnr_db["own", "light_field"]
    usual = int(np.argsort(quality, kind="stable")[len(quality) // 2])
    number = results[0].photos[usual]
    photo = next(islice(photos(views), number, None))
    shown = part_views(photo, true_views, plane, parts, step=1)
    write_figure(path, results, photo.image, shown)
