"""One side of ``against``: does pieces of work when asked, with the lfnav that is installed.

    python benchmarks/against_worker.py FOLDER

FOLDER holds the scenes and the sequence (see ``against``). The first line that is written lists the
pieces of work. Each line that is read asks for one and says how long to repeat it, ``{"work": "a
depth map", "seconds": 0.3}``; the answer is a line with the time of one particle, view, alignment
or depth map, ``{"cpu_s": 0.1, "wall_s": 0.1}``. All of it on one thread. Nothing but ``pipelines``
is imported, so that older revisions can do it too.
"""

import functools
import importlib.util
import json
import sys
import time
import types
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np

# Where these modules were in older revisions.
BEFORE = {
    "pipelines.artifacts.stages": "pipelines.artifacts.progress",
    "pipelines.lightfield.scene_file": "pipelines.lightfield.bundle",
    "pipelines.lightfield.stereo_depth": "pipelines.lightfield.depth",
    "pipelines.localize.alignment": "pipelines.localize.refinement",
    "pipelines.render.blending": "pipelines.lightfield.blending",
    "pipelines.render.devices": "pipelines.lightfield.devices",
    "pipelines.render.renderer": "pipelines.lightfield.renderer",
    "pipelines.render.surface": "pipelines.lightfield.proxy",
}
is_old = importlib.util.find_spec("pipelines.render") is None
if is_old:
    sys.modules |= {name: importlib.import_module(before) for name, before in BEFORE.items()}
if is_old or importlib.util.find_spec("pipelines.render.choices") is None:
    choices = types.ModuleType("pipelines.render.choices")
    for module, name in (("blending", "Blending"), ("surface", "Quality")):
        setattr(choices, name, getattr(importlib.import_module(f"pipelines.render.{module}"), name))
    sys.modules[choices.__name__] = choices

from pipelines.artifacts.stages import no_progress  # noqa: E402
from pipelines.dataset.dataset import load_dataset  # noqa: E402
from pipelines.dataset.images import decode_image, read_image_bytes  # noqa: E402
from pipelines.geometry.camera import Undistorter  # noqa: E402
from pipelines.lightfield.depth_maps import depth_from_photos  # noqa: E402
from pipelines.lightfield.scene import Scene  # noqa: E402
from pipelines.lightfield.scene_file import load_scene  # noqa: E402
from pipelines.lightfield.stereo_depth import DepthSettings  # noqa: E402
from pipelines.localize import alignment  # noqa: E402
from pipelines.localize.likelihood import LIKELIHOODS  # noqa: E402
from pipelines.localize.measurement_model import MeasurementModel  # noqa: E402
from pipelines.localize.observation import Observation, Observer  # noqa: E402
from pipelines.localize.settings import LocalizerSettings  # noqa: E402
from pipelines.localize.state_space import PLANAR  # noqa: E402
from pipelines.reconstruct.reconstruction import load_reconstruction, with_images  # noqa: E402
from pipelines.render.choices import Blending, Quality  # noqa: E402
from pipelines.render.devices import Device  # noqa: E402
from pipelines.render.renderer import Renderer  # noqa: E402

# What this function was called in older revisions.
align_state = vars(alignment).get("align") or vars(alignment)["refine"]

# As a setting of the likelihood, the fourth, is called.
SUBSAMPLING = fields(LIKELIHOODS["evidence"])[3].name
# The camera image, and where particles stand around it: metres and radians.
FRAME, SPREAD, PARTICLES = 8, (0.1, 0.1, 0.05), 195
WIDTHS = (40, 80, 160)
# A view as large as a photo; depth maps of so many photos.
VIEW_SIZE, DEPTH_VIEWS = (640, 480), 9
SURFACES = {"plane": Quality.PLANE, "depth": Quality.MEDIUM}


class Side:
    """What can be done.

    Args:
        folder: with ``plane.h5``, ``depth.h5``, ``plane-1000.h5``, ``test`` and ``map``.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        dataset = load_dataset(folder / "test")
        if dataset.camera is None or dataset.groundtruth is None:
            raise ValueError(f"{folder}/test has no camera or no ground truth")
        self._mount = dataset.body_from_camera
        self._images = dict(Observer(dataset.camera, WIDTHS)(dataset.read_image(FRAME)).by_width)
        nearest = dataset.groundtruth.nearest(dataset.timestamps, 0.1)[FRAME]
        self._truth = PLANAR.states(dataset.groundtruth.poses[[nearest]])[0]
        noise = np.random.default_rng(0).standard_normal((PARTICLES, 3)) * SPREAD
        self._states = PLANAR.moved(np.repeat(self._truth[None], PARTICLES, axis=0), noise)

    @functools.cached_property
    def work(self) -> dict[str, tuple[Callable[[], object], int]]:
        """Name -> what to do, and into how many parts its time is divided."""
        found: dict[str, tuple[Callable[[], object], int]] = {}
        for surface in SURFACES:
            for blending in Blending:
                name = f"{surface}, {blending.name.lower()}"
                for width, image in self._images.items():
                    size = f"{width}x{image.image.shape[0]}"
                    for one_in, pixels in ((1, "all pixels"), (5, "one pixel in 5")):
                        found[f"{name}, {size}, {pixels}"] = self._particles(
                            surface, blending, width, one_in
                        )
                found[f"{name}, a view of 640x480"] = self._view(surface, blending), 1
            found[f"{surface}, alignment from 40x30 to 160x120"] = self._alignment(surface), 1
        for blending in Blending:
            name = f"plane of 1000 views, {blending.name.lower()}, 40x30, one pixel in 5"
            found[name] = self._particles("plane-1000", blending, 40, 5)
        found["a depth map"] = self._depth_maps, DEPTH_VIEWS
        return found

    def _particles(
        self, scene: str, blending: Blending, width: int, one_in: int
    ) -> tuple[Callable[[], object], int]:
        def score() -> object:
            model = self._model(scene, blending, width, one_in)
            return model.log_likelihoods(self._states, self._images[width])

        return score, PARTICLES

    @functools.cache  # noqa: B019 - there is one side a process
    def _scene(self, name: str) -> Scene:
        return load_scene(self._folder / f"{name}.h5")

    @functools.cache  # noqa: B019
    def _model(self, scene: str, blending: Blending, width: int, one_in: int) -> MeasurementModel:
        settings = LocalizerSettings(
            likelihood=replace(LIKELIHOODS["evidence"], **{SUBSAMPLING: one_in}),  # type: ignore[arg-type]
            coarse_width=min(WIDTHS),
            fine_width=width,
            refine_width=0,
            blending=blending,
            quality=SURFACES[scene.partition("-")[0]].name.lower(),
            threads=1,
            device=Device.CPU,
        )
        model = MeasurementModel.of_scene(self._scene(scene), self._mount, settings)
        # What differences say is learnt once, before any particle.
        model.pixels(width)
        return model

    @functools.cache  # noqa: B019
    def _renderer(self, scene: str, blending: Blending, longer: int) -> Renderer:
        quality = SURFACES[scene]
        return Renderer.of_scene(self._scene(scene), longer, blending, quality, threads=1)

    def _view(self, surface: str, blending: Blending) -> Callable[[], object]:
        def draw() -> object:
            scene = self._scene(surface)
            intrinsics = scene.camera_of(0).intrinsics.resized(*VIEW_SIZE)
            pose = PLANAR.poses(self._truth) @ self._mount
            return self._renderer(surface, blending, max(VIEW_SIZE)).render(pose, intrinsics)

        return draw

    def _alignment(self, surface: str) -> Callable[[], object]:
        def align() -> object:
            renderer = self._renderer(surface, Blending.UNSTRUCTURED, max(VIEW_SIZE))
            images: list[Observation] = list(self._images.values())
            # A few centimetres and a degree aside.
            start = PLANAR.moved(self._truth, np.array([0.03, -0.03, 0.02]))
            return align_state(renderer, PLANAR, start, self._mount, images)

        return align

    def _depth_maps(self) -> object:
        source = with_images(load_reconstruction(self._folder / "map"), np.arange(DEPTH_VIEWS))
        undistorters = [Undistorter(camera) for camera in source.cameras]
        chosen = [undistorters[int(index)] for index in source.camera_index]
        photos = [
            undistorter(decode_image(read_image_bytes(source.image_root / name), name))
            for undistorter, name in zip(chosen, source.image_names, strict=True)
        ]
        pinholes = [undistorter.intrinsics for undistorter in chosen]
        plane = self._scene("plane").plane
        return depth_from_photos(
            source, photos, pinholes, plane, DepthSettings(), None, no_progress
        )


def main(arguments: list[str]) -> None:
    """Answers until the standard input ends."""
    cv2.setNumThreads(1)
    side = Side(Path(arguments[0]))
    print(json.dumps(list(side.work)), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        task, parts = side.work[request["work"]]
        count, cpu, wall = 0, time.process_time(), time.perf_counter()
        while count == 0 or time.perf_counter() - wall < request["seconds"]:
            task()
            count += parts
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        print(json.dumps({"cpu_s": cpu / count, "wall_s": wall / count}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
