"""How well a light field predicts photos: held-out photos compared with rendered views.

Either another data set with known poses is rendered, or every view of the scene from all others.
Beside the rendering stand two baselines: the nearest photo as it is, and the same light field over
a single plane.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.views import views_of_scene
from pipelines.render.choices import Blending, Quality
from pipelines.render.held_out import (
    HeldOut,
    lie_amid_others,
    photos_of_dataset,
    posed_photos,
    views_one_by_one,
)
from pipelines.render.image_quality import psnr, ssim
from pipelines.render.renderer import Renderer
from pipelines.render.surface import ROTATION_COST, quality_named

METHODS = ("light_field", "plane", "nearest_photo")
MEASURES = ("psnr_db", "ssim", "coverage")


@dataclass(frozen=True)
class SceneEvaluation:
    """Measures a frame of the light field and of the baselines.

    Attributes:
        scene_path: the scene.
        against: what it was compared with, for people.
        quality: name of the surface's quality.
        blending: name of its rule.
        values: method -> measure -> ``(F,)``.
    """

    scene_path: Path
    against: str
    quality: str
    blending: str
    values: dict[str, dict[str, FloatArray]]

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        names = {
            "light_field": f"light field ({self.quality}, {self.blending})",
            "plane": "light field over one plane",
            "nearest_photo": "nearest photo",
        }
        rows: list[tuple[str, ...]] = [
            (self.against, "PSNR (dB)", "least", "SSIM", "least", "coverage", "least")
        ]
        for method in self.values:
            row = [names[method]]
            for measure, form in zip(MEASURES, ("{:.2f}", "{:.3f}", "{:.1%}"), strict=True):
                values = self.values[method][measure]
                row += [form.format(values.mean()), form.format(values.min())]
            rows.append(tuple(row))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        measures = {method: _statistics(of) for method, of in self.values.items()}
        return {
            "scene": str(self.scene_path),
            "against": self.against,
            "quality": self.quality,
            "blending": self.blending,
            "frames": len(self.values["light_field"]["psnr_db"]),
            **measures["light_field"],
            "baselines": {
                method: measures[method]
                for method in ("nearest_photo", "plane")
                if method in measures
            },
        }


def evaluate_scene(
    scene_path: Path,
    dataset: Path | None,
    poses: Path | None,
    quality: str | None,
    blending: Blending,
    progress: Progress,
    *,
    interior: bool = False,
    max_gap: float = MAX_GAP,
) -> SceneEvaluation:
    """Renders held-out photos at their known poses and compares.

    Args:
        scene_path: scene model.
        dataset: photos with poses; None: each view of the scene, from all the others.
        poses: TUM file of the data set's world_from_body; None: its ground truth.
        quality: name of a ``Quality``; None: the finest that the scene has depth maps for.
        blending: the rule that chooses and weights the views.
        progress: told how far the work is.
        interior: without a data set: only views that were taken amid the others.
        max_gap: seconds between two of the poses between which a photo's is interpolated, at most.

    Raises:
        InputError: the data set has no camera or no poses, or something cannot be read.
        StageError: a scene of one view has nothing to leave out, or no view lies amid the others.
    """
    scene = load_scene(scene_path)
    chosen = quality_named(quality, bool(scene.depth), Quality.FINE)
    views = views_of_scene(scene, progress=progress)
    if dataset is None:
        if len(scene) < 2:
            raise StageError(f"{scene_path} holds one view: nothing is left when it is left out")
        left_out = np.flatnonzero(lie_amid_others(views.centres) | (not interior)).tolist()
        if not left_out:
            raise StageError(f"{scene_path}: no view was taken amid the others")
        held_out, count = views_one_by_one(scene, views, left_out), len(left_out)
        against = "each view from the others"
        if interior:
            against = f"{count} interior views of {len(scene)}, each from the others"
    else:
        frames, camera_poses = posed_photos(load_dataset(dataset), poses, max_gap)
        count = len(frames)
        held_out = photos_of_dataset(frames, camera_poses, views)
        against = f"{count} photos of {dataset.resolve().name}"
    values: dict[str, dict[str, list[float]]] = {
        method: {measure: [] for measure in MEASURES}
        for method in METHODS
        if method != "plane" or scene.surface is not None
    }
    for photo in progress(held_out, "evaluate", count):
        for method, (image, covered) in _shown(photo, scene, chosen, blending).items():
            values[method]["psnr_db"].append(psnr(image, photo.image, covered))
            values[method]["ssim"].append(ssim(image, photo.image, covered))
            values[method]["coverage"].append(float(covered.mean()))
    return SceneEvaluation(
        scene_path,
        against,
        chosen.name.lower(),
        blending.name.lower(),
        {m: {k: np.array(v) for k, v in of.items()} for m, of in values.items()},
    )


def _shown(
    photo: HeldOut, scene: Scene, quality: Quality, blending: Blending
) -> dict[str, tuple[ImageArray, BoolArray]]:
    """What each method shows at the photo's pose, and which pixels it covers."""
    shown = {"nearest_photo": _nearest_photo(photo)}
    surfaces = [("plane", Quality.PLANE), ("light_field", quality)]
    for method, finest in surfaces if scene.surface is not None else surfaces[1:]:
        if finest is Quality.PLANE and "plane" in shown:
            shown[method] = shown["plane"]
            continue
        renderer = Renderer(photo.views, scene.plane_if_any, blending, finest, threads=1)
        rendering = renderer.render(photo.world_from_camera, photo.intrinsics)
        shown[method] = rendering.image, rendering.covered
    return shown


def _nearest_photo(photo: HeldOut) -> tuple[ImageArray, BoolArray]:
    """The photo taken from the nearest position in the most similar direction, unchanged."""
    arrays = photo.views.arrays
    pose = photo.world_from_camera
    distance = np.linalg.norm(arrays.centres - pose[:3, 3], axis=1)
    rotation = np.sqrt(np.maximum(2.0 - 2.0 * (arrays.axes @ pose[:3, 2]), 0.0))
    # Lengths count in units of the median distance from the recording centres.
    unit = float(np.median(distance)) or 1.0
    nearest = int(np.argmin(distance / unit + ROTATION_COST * rotation))
    size = (photo.intrinsics.width, photo.intrinsics.height)
    image = cv2.resize(photo.views.level(nearest, 0), size, interpolation=cv2.INTER_AREA)
    return np.asarray(image, dtype=np.uint8), np.ones(size[::-1], dtype=bool)


def _statistics(values: dict[str, FloatArray]) -> dict[str, Any]:
    return {
        measure: {
            "mean": float(of.mean()),
            "min": float(of.min()),
            "per_frame": of.tolist(),
        }
        for measure, of in values.items()
    }
