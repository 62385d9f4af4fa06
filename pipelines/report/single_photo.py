"""The stage ``localize`` for a photo by itself: its pose, and a picture by which to judge it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.atomic import check_output, write_bytes
from pipelines.artifacts.errors import OptionError
from pipelines.dataset.single_photo import read_photo
from pipelines.lightfield.open_world import OpenWorld, scene_or_world
from pipelines.lightfield.scene import Scene
from pipelines.localize.run import Run, save_run
from pipelines.localize.scene_of_run import relative_scene_path
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.single_photo import PhotoSummary, answer_of, locate_photo, with_focal_length
from pipelines.report.figures import png_of
from pipelines.report.style import figure_style
from pipelines.report.views import FrameViews, ViewMaker, renderer_at

# Grey levels at which the picture of differences is darkest.
LARGEST_DIFFERENCE = 64.0
# Inches: of each picture, and of the lines above them.
WIDTH, TITLES = 4.0, 0.7


@dataclass(frozen=True)
class PhotoRequest:
    """Which photo is to be located in what.

    Attributes:
        scene: scene model, or the folder of a world of several.
        photo: JPEG or PNG.
        settings: of the filter, with six degrees of freedom.
        camera: ``camera.toml`` of the photo; None: EXIF data or the map's camera.
        run: run file to write; None: none.
        picture: PNG to write: the photo, what the map shows at the pose, and their difference;
            None: none.
        seed: of the filter's random numbers, not negative.
        overwrite: whether existing files may be replaced.
        memory: megabytes that a world may take; None: the default.
    """

    scene: Path
    photo: Path
    settings: LocalizerSettings
    camera: Path | None = None
    run: Path | None = None
    picture: Path | None = None
    seed: int = 0
    overwrite: bool = False
    memory: float | None = None


def localize_photo(request: PhotoRequest) -> PhotoSummary:
    """Locates a photo, and writes run and picture where they are asked for.

    Raises:
        InputError: a file cannot be used, or an output not be written.
        OptionError: settings that make no sense for a photo by itself, or no PNG.
    """
    outputs = [path for path in (request.run, request.picture) if path is not None]
    for path in outputs:
        check_output(path, request.overwrite)
    if request.picture is not None and request.picture.suffix.lower() != ".png":
        raise OptionError(f"{request.picture}: the picture is a PNG; name it so")
    scene = scene_or_world(request.scene, request.memory)
    photo = read_photo(request.photo, request.camera, scene.cameras)
    if photo.is_rough:
        photo = with_focal_length(scene, photo, request.seed)
    run = locate_photo(
        scene,
        photo,
        request.settings,
        seed=request.seed,
        scene_path="" if request.run is None else relative_scene_path(request.scene, request.run),
    )
    if request.run is not None:
        save_run(request.run, run, request.overwrite)
    if request.picture is not None:
        write_bytes(request.picture, side_by_side(scene, run), request.overwrite)
    return PhotoSummary(run, photo.camera_source, tuple(outputs))


def side_by_side(scene: Scene | OpenWorld, run: Run) -> bytes:
    """A PNG: the photo, the map's view at the estimated pose, and their difference.

    Args:
        scene: in which it was located.
        run: of one frame.
    """
    state = np.full(run.space.dimension, np.nan)
    if run.own_estimate_names:
        state = run.estimated_states()[0]
    views = ViewMaker(run, renderer_at(scene)).views(0, state, None)
    with figure_style():
        return png_of(_drawn(views, answer_of(run.frames[0])))


def _drawn(views: FrameViews, answer: str) -> Figure:
    pictures: list[tuple[str, ImageArray | FloatArray]] = [("photo", views.real)]
    shown = views.at_estimate
    if shown is not None:
        pictures.append(("map, from the estimated pose", shown.picture))
        grey = 255.0 * (1.0 - np.clip(shown.difference / LARGEST_DIFFERENCE, 0.0, 1.0))
        difference = np.where(shown.covered, grey, 255.0)
        pictures.append((f"difference, mean {shown.mean_difference:.1f} of 255", difference))
    height, width = views.real.shape[:2]
    size = (WIDTH * len(pictures), WIDTH * height / width + TITLES)
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(answer)
    axes = figure.subplots(1, len(pictures), squeeze=False)[0]
    for axis, (title, picture) in zip(axes, pictures, strict=True):
        axis.imshow(picture, cmap="gray", vmin=0, vmax=255)
        axis.set_title(title)
        axis.set_axis_off()
    return figure
