"""Where was this taken? The pose of a photo by itself, without odometry or a photo before it.

The camera is the body, with six degrees of freedom. Features propose a pose, and the light field
decides: one step of the localizer, begun around it, tells whether the map shows the photo from
there. Where features propose none, or one that is not firm, it looks all over the map.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.artifacts.arguments import checked_instance, checked_number
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.provenance import provenance, sha256_of_bytes
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.single_photo import SinglePhoto
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import quaternion_of
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.landmarks import LandmarkSource
from pipelines.localize.localizer import Localizer
from pipelines.localize.pnp import MountedCamera, PnpLocalizer
from pipelines.localize.run import FrameRecord, Run
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import SPATIAL

ANSWERS = {
    "tracking": "found",
    "global": "perhaps found: by itself it does not tell this place from others",
    "lost": "not found in the map",
    "blind": "shows too little to tell",
    "stale": "shows too little to tell",
}
# Poses by features are good to a few centimetres and degrees.
PROPOSAL_POSITION_SIGMA, PROPOSAL_ANGLE_SIGMA = 0.1, math.radians(3.0)
# EXIF data are not further off than this share of the focal length.
LARGEST_CORRECTION = 0.15
# A place with less of the probability is not worth naming.
SMALLEST_SHARE = 0.01
ROUGH = "good to some percent, and the pose as well: give --camera"


def locate_photo(
    scene: Scene | OpenWorld,
    photo: SinglePhoto,
    settings: LocalizerSettings | None = None,
    *,
    seed: int = 0,
    scene_path: str = "",
) -> Run:
    """Finds where a photo was taken.

    Args:
        scene: the light field, or a world of several.
        photo: with its camera.
        settings: of the filter, with six degrees of freedom; None: the defaults.
        seed: of the filter's random numbers, not negative.
        scene_path: how the run refers to its scene.

    Returns:
        A run of one frame, whose body is the camera.

    Raises:
        OptionError: other degrees of freedom, settings that make no sense for this scene, or an
            argument of another type.
        InputError: a photo of the scene cannot be decoded.
    """
    settings = LocalizerSettings(degrees_of_freedom=6) if settings is None else settings
    checked_instance(photo, "the photo", SinglePhoto)
    checked_instance(settings, "settings", LocalizerSettings)
    checked_number(seed, "seed", 0, whole=True)
    if settings.degrees_of_freedom != 6 or settings.method != "filter":
        raise OptionError("a photo by itself is located by the filter with 6 degrees of freedom")
    frame = None
    state = None
    if isinstance(scene, Scene) and settings.start is None:
        state = _features(scene, photo.camera, seed).locate(photo.image).state
    if state is not None:
        near = replace(
            settings,
            start=tuple(state.tolist()),
            start_position_sigma=PROPOSAL_POSITION_SIGMA,
            start_heading_sigma=PROPOSAL_ANGLE_SIGMA,
        )
        frame = _step(scene, photo, near, seed)
    if frame is None or not _is_firm(frame):
        frame = _step(scene, photo, settings, seed)
    inputs = {"scene": scene.identifier, "photo": sha256_of_bytes(photo.encoded)}
    return Run(
        scene_identifier=scene.identifier,
        scene_path=scene_path,
        dataset_name=photo.name,
        camera=photo.camera,
        base_from_camera=np.eye(4),
        settings=settings.to_dict(),
        seed=seed,
        frames=(frame,),
        encoded_images=(photo.encoded,),
        odometry=None,
        groundtruth=None,
        provenance=provenance("localize", {**settings.to_dict(), "seed": seed}, inputs),
        areas=scene.area_map if isinstance(scene, OpenWorld) else None,
    )


def _step(
    scene: Scene | OpenWorld, photo: SinglePhoto, settings: LocalizerSettings, seed: int
) -> FrameRecord:
    """What the localizer makes of the photo."""
    rng = np.random.default_rng(seed)
    localizer = Localizer(scene, photo.camera, np.eye(4), settings, rng)
    return localizer.step(photo.image, None, 0.0, photo.name)


def _is_firm(frame: FrameRecord) -> bool:
    """Whether the photo was aligned where the particles are, and not only weighted there."""
    return frame.status == "tracking" and "refined" in frame.estimates


def _features(scene: Scene, camera: Camera, seed: int) -> PnpLocalizer:
    """Finds a pose by features alone."""
    return PnpLocalizer(
        scene,
        LandmarkSource(scene, None),
        MountedCamera(camera, np.eye(4)),
        SPATIAL,
        seed=seed,
        threads=None,
        progress=no_progress,
    )


def with_focal_length(scene: Scene | OpenWorld, photo: SinglePhoto, seed: int) -> SinglePhoto:
    """The photo with a focal length that features of the map and of the photo agree on.

    A focal length that is some percent off moves the pose by as much of the distance to what is
    seen. Features cannot tell it where the scene is flat and seen from the front.

    Args:
        scene: the light field; in a world the photo stays as it is.
        photo: whose camera is rough.
        seed: of RANSAC.

    Raises:
        InputError: a photo of the scene cannot be decoded.
    """
    if isinstance(scene, OpenWorld):
        return replace(photo, camera_source=f"{photo.camera_source}, {ROUGH}")
    pnp = _features(scene, photo.camera, seed)
    focal, stated = pnp.focal_length(photo.image), photo.camera.intrinsics.fx
    if focal is None or abs(focal / stated - 1.0) > LARGEST_CORRECTION:
        return replace(photo, camera_source=f"{photo.camera_source}, {ROUGH}")
    camera = replace(photo.camera, params=(focal, *photo.camera.params[1:]))
    source = f"{photo.camera_source}; focal length by features {focal / stated - 1.0:+.1%}"
    return replace(photo, camera=camera, camera_source=source, is_rough=False)


def answer_of(frame: FrameRecord) -> str:
    """What the localizer made of a photo, in words."""
    is_weak = frame.status == "tracking" and not _is_firm(frame)
    return ANSWERS["global" if is_weak else frame.status]


@dataclass(frozen=True)
class PhotoSummary:
    """Where a photo was taken, for people and for programs.

    Attributes:
        run: as ``locate_photo`` makes it.
        camera_source: where its camera is from.
        outputs: what was written.
    """

    run: Run
    camera_source: str
    outputs: tuple[Path, ...]

    @property
    def world_from_camera(self) -> FloatArray | None:
        """``(4, 4)`` the pose, metres; None where the map does not show the photo."""
        if not self.run.own_estimate_names:
            return None
        state = self.run.estimated_states()[0]
        return np.asarray(self.run.space.poses(state[None])[0])

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        run, frame = self.run, self.run.frames[0]
        rows: list[tuple[str, ...]] = [("photo", run.dataset_name)]
        rows.append(("answer", answer_of(frame)))
        pose = self.world_from_camera
        if pose is not None:
            x, y, z = pose[:3, 3]
            rows += [("position", f"x {x:.3f}, y {y:.3f}, z {z:.3f} m"), ("looks to", _looks(pose))]
            spread = self._sigmas()
            if spread is not None:
                rows.append(
                    ("standard deviation", f"{spread[0]:.3f} m, {math.degrees(spread[1]):.2f} deg")
                )
            rows += [
                ("another place", f"{_place(run, mode)} with probability {mode[-1]:.2f}")
                for mode in frame.modes[1:]
                if frame.status == "global" and mode[-1] >= SMALLEST_SHARE
            ]
        rows += [
            ("confidence", f"{frame.confidence:.2f} (within 0.1 m and 3 degrees)"),
            ("camera", f"{run.camera.model} {run.camera.width}x{run.camera.height}"),
            ("camera from", self.camera_source),
            ("seconds", f"{float(run.frame_seconds[0]):.2f}"),
        ]
        return rows + [("written", str(path)) for path in self.outputs]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        run, frame, pose = self.run, self.run.frames[0], self.world_from_camera
        covariance = frame.refined_covariance
        if covariance is None and pose is not None:
            covariance = frame.covariance
        return {
            "photo": run.dataset_name,
            "answer": answer_of(frame),
            "status": frame.status,
            "world_from_camera": None if pose is None else pose.tolist(),
            "position_m": None if pose is None else pose[:3, 3].tolist(),
            "quaternion_xyzw": None if pose is None else quaternion_of(pose).tolist(),
            "covariance": None if covariance is None else covariance.tolist(),
            "confidence": float(frame.confidence),
            "places": [
                {"position_m": run.space.poses(mode[None, :-1])[0, :3, 3].tolist(), "share": share}
                for mode, share in zip(frame.modes, frame.modes[:, -1].tolist(), strict=True)
                if pose is not None
            ],
            "camera": run.camera.to_dict(),
            "camera_from": self.camera_source,
            "seed": run.seed,
            "outputs": [str(path) for path in self.outputs],
        }

    def _sigmas(self) -> tuple[float, float] | None:
        """Standard deviation of the place, metres, and of the angle, radians, all axes together."""
        covariance = self.run.frames[0].refined_covariance
        if covariance is None:
            return None
        variances = np.diag(covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))


def _looks(pose: FloatArray) -> str:
    """The direction of the optical axis."""
    x, y, z = pose[:3, 2]
    heading, rise = math.degrees(math.atan2(y, x)), math.degrees(math.asin(np.clip(z, -1.0, 1.0)))
    return f"{heading:.1f} deg from the x axis, {abs(rise):.1f} deg {'up' if rise > 0 else 'down'}"


def _place(run: Run, mode: FloatArray) -> str:
    x, y, z = run.space.poses(mode[None, :-1])[0, :3, 3]
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f} m"
