"""The classical way beside the light field: where SIFT and perspective-n-point say the camera is.

Features of the scene's photos that have a place in the world (``landmarks``) are matched with those
of a camera image, and the pose is computed from the pairs. At least ``MIN_INLIERS`` features have
to agree on it, else there is no pose: nothing stands in for it, no earlier pose and no photo's.

This is the parent's side; features, matches and poses come from ``pnp_worker`` in a process of its
own, which lives as long as a ``PnpLocalizer``.
"""

import base64
import json
import math
import os
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.artifacts.progress import Progress
from pipelines.artifacts.worker_process import WorkerProcess, worker_command
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, pose_from_rotation
from pipelines.lightfield.scene import Scene
from pipelines.localize.landmarks import LandmarkSource
from pipelines.localize.observation import check_mask
from pipelines.localize.pnp_worker import Settings
from pipelines.localize.state_space import StateSpace
from pipelines.reconstruct.colmap_model import colmap_params
from pipelines.reconstruct.reconstruction import Reconstruction

# Random matches came back with five features that agree; chance does not make thirty.
MIN_INLIERS = 30
MAX_SIZE = 960
MAX_FEATURES = 2048
MAX_THREADS = 16
MAX_SEED = 2**31 - 1
# A robot on the floor neither hovers nor leans: such a pose is wrong, metres and radians.
LARGEST_HEIGHT, LARGEST_TILT = 0.3, math.radians(10.0)

WORKER_COMMAND = worker_command("pipelines.localize.pnp_worker")
# Threads of its own would make no result faster, but could change the order of sums.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@dataclass(frozen=True)
class PnpAnswer:
    """What perspective-n-point says of one image.

    Attributes:
        state: ``(D,)`` of the body; None: no pose.
        covariance: ``(D, D)`` of its error, if every landmark is where it is thought to be; None
            where there is no pose.
        inliers: features of the image that agree on the pose.
        matches: features that match a landmark.
        seconds: wall time.
    """

    state: FloatArray | None
    covariance: FloatArray | None
    inliers: int
    matches: int
    seconds: float

    @property
    def confidence(self) -> float:
        """0 to 1, rising with the inliers n: n / (n + 30); 0 without a pose."""
        return 0.0 if self.state is None else self.inliers / (self.inliers + MIN_INLIERS)

    @property
    def hypotheses(self) -> FloatArray | None:
        """The pose as ``(1, D)`` states, or None."""
        return None if self.state is None else self.state[None]


class PnpLocalizer:
    """Finds poses in one scene, each image for itself; to be used in a ``with`` block.

    The same images and seed give the same answers, with any number of threads.

    Args:
        scene: the map.
        camera: of the robot.
        body_from_camera: ``(4, 4)`` its mount.
        space: what a state is. In ``planar`` the pose is projected to the floor; one that hovers or
            leans is none.
        seed: of RANSAC.
        threads: at most; None: all processors.
        reconstruction: whose points are the landmarks; None: places on the scene's surface are.
        reconstruction_path: how errors name it.
        progress: shown while the features of the photos are sought.
        mask: ``(height, width)``, True where images of the camera are to be used; None: everywhere.

    Raises:
        OptionError: a mask of another size than the camera.
        InputError: a photo of the scene cannot be decoded, or the reconstruction is not the scene's
            or has no points.
        StageError: the worker ended before its time.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        body_from_camera: FloatArray,
        space: StateSpace,
        *,
        seed: int,
        threads: int | None,
        reconstruction: Reconstruction | None,
        reconstruction_path: str,
        progress: Progress,
        mask: BoolArray | None = None,
    ) -> None:
        if mask is not None:
            check_mask(mask, camera)
        self._mask = mask
        self._scene = scene
        self._camera = camera
        self._body_from_camera = body_from_camera
        self._space = space
        self._source = LandmarkSource(scene, reconstruction, reconstruction_path)
        self._progress = progress
        self._settings = Settings(
            camera_model=camera.model,
            width=camera.width,
            height=camera.height,
            camera_params=list(colmap_params(camera)),
            max_size=MAX_SIZE,
            max_features=MAX_FEATURES,
            min_inliers=MIN_INLIERS,
            seed=seed % MAX_SEED,
            threads=min(MAX_THREADS, threads or os.cpu_count() or 1),
        )
        self._resources = ExitStack()

    def __enter__(self) -> "PnpLocalizer":
        with ExitStack() as resources:
            folder = resources.enter_context(tempfile.TemporaryDirectory(prefix="lfnav_pnp_"))
            command = (*WORKER_COMMAND, json.dumps(asdict(self._settings)))
            self._worker = resources.enter_context(
                WorkerProcess(command, Path(folder), "localization by features", ENVIRONMENT)
            )
            self._describe_photos()
            if self._mask is not None:
                self._ask({"do": "mask", **_packed(self._mask.astype(np.uint8))})
            self._resources = resources.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._resources.close()

    def locate(self, image: ImageArray) -> PnpAnswer:
        """The body's pose when the camera took an image ``(height, width, 3)``, RGB as recorded.

        Raises:
            OptionError: an image of another size than the camera.
            StageError: the worker ended before its time.
        """
        if image.shape[:2] != (self._camera.height, self._camera.width):
            raise OptionError(
                f"image is {image.shape[1]}x{image.shape[0]}, "
                f"its camera {self._camera.width}x{self._camera.height}"
            )
        start = time.perf_counter()
        found = self._ask({"do": "locate", **_encoded(image)})
        state = covariance = None
        if "camera_from_world" in found:
            state, covariance = self._of_body(found)
        seconds = time.perf_counter() - start
        return PnpAnswer(state, covariance, found["inliers"], found["matches"], seconds)

    def _describe_photos(self) -> None:
        """Hands the worker the scene's photos, and where their features are."""
        count = len(self._scene)
        for view in self._progress(range(count), "features of the scene", count):
            found = self._ask({"do": "describe", **_encoded(self._scene.image(view))})
            pixels = np.array(found["pixels"], dtype=np.float64).reshape(-1, 2)
            landmarks = self._source.landmarks(view, pixels)
            self._ask(
                {
                    "do": "landmarks",
                    "rows": landmarks.rows.tolist(),
                    "points": landmarks.points.tolist(),
                }
            )

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        self._worker.write(request)
        answer = self._worker.read()
        wanted = {"describe": {"pixels"}, "locate": {"inliers", "matches"}}
        if not wanted.get(request["do"], set()) <= set(answer):
            raise StageError(f"the worker for localization by features said {answer!r}")
        return answer

    def _of_body(self, found: dict[str, Any]) -> tuple[FloatArray, FloatArray] | tuple[None, None]:
        """State and covariance of the body; nothing where a robot on the floor cannot be so."""
        camera_from_world = np.array(found["camera_from_world"])
        world_from_camera = inverse(
            pose_from_rotation(camera_from_world[:, :3], camera_from_world[:, 3])
        )
        pose = world_from_camera @ inverse(self._body_from_camera)
        is_planar = self._space.angles == 1
        if is_planar and not _is_on_floor(pose):
            return None, None
        arm = pose[:3, 3] - world_from_camera[:3, 3]
        covariance = covariance_at(arm, np.array(found["covariance"]))
        if is_planar:
            kept = [0, 1, 5]
            covariance = covariance[np.ix_(kept, kept)]
        return self._space.states(pose), covariance


def covariance_at(arm: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance ``(6, 6)`` of place and turn at the end of an arm ``(3,)`` from the camera.

    Both covariances, and the arm, are in world axes; what is at the end turns with the camera.
    """
    transfer = np.eye(6)
    # A small turn w moves the end by w x arm.
    transfer[:3, 3:] = np.cross(np.eye(3), arm).T
    return np.asarray(transfer @ covariance @ transfer.T)


def _is_on_floor(pose: FloatArray) -> bool:
    tilt = math.acos(min(1.0, max(-1.0, float(pose[2, 2]))))
    return abs(float(pose[2, 3])) <= LARGEST_HEIGHT and tilt <= LARGEST_TILT


def _encoded(image: ImageArray) -> dict[str, Any]:
    """Brightness of an RGB image, as the worker takes it."""
    return _packed(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8))


def _packed(grey: ImageArray) -> dict[str, Any]:
    """An array ``(height, width)`` as JSON."""
    height, width = grey.shape
    return {
        "image": base64.b64encode(grey.tobytes()).decode("ascii"),
        "height": height,
        "width": width,
    }
