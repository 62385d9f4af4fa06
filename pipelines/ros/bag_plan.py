"""What of a bag becomes the data set: which images, their camera, its mount, and the poses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray, IntArray
from pipelines.artifacts.errors import InputError, OptionError, StageError, quoted
from pipelines.artifacts.stages import Progress
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.camera import Camera
from pipelines.geometry.interpolation import MAX_GAP
from pipelines.geometry.pose import base_from_camera_mount
from pipelines.geometry.trajectory import Trajectory
from pipelines.ros.bag_file import Bag
from pipelines.ros.bag_survey import Survey, survey_bag
from pipelines.ros.bag_topics import (
    CameraTopic,
    choose_camera,
    find_cameras,
    find_ground_truth,
    find_odometry,
    frame_pair,
    is_frame_pair,
)
from pipelines.ros.camera_info import camera_of_info
from pipelines.ros.pose_track import NANOSECONDS, PoseTrack, moved_enough
from pipelines.ros.tf_tree import TransformTree, base_of_tf, odometry_frames

# Degrees from straight up within which a camera that is mounted on a robot is remarkable.
LOOKS_UP_DEG = 30.0


@dataclass(frozen=True)
class PoseSource:
    """Poses of a frame of the robot over time.

    Attributes:
        text: the topic, or the frames of tf, for people.
        child: the frame whose poses they are; empty where nothing says.
        track: the poses.
    """

    text: str
    child: str
    track: PoseTrack


@dataclass(frozen=True)
class BagPlan:
    """What is written.

    Attributes:
        camera_topic: where the images are.
        arrivals: ``(N,)`` which of the topic's images, in the order of their receipt, is the first,
            second ... of the data set.
        stamps: ``(N,)`` their times, ns, strictly increasing.
        camera: that took them.
        base_from_camera: ``(4, 4)``; None where the body is the camera.
        base: the robot's frame; None likewise.
        odometry, groundtruth: world_from_body at the images; None where there is none.
        odometry_source, groundtruth_source: where they come from, for people.
        notes: what the user should know.
    """

    camera_topic: CameraTopic
    arrivals: IntArray
    stamps: IntArray
    camera: Camera
    base_from_camera: FloatArray | None
    base: str | None
    odometry: Trajectory | None
    groundtruth: Trajectory | None
    odometry_source: str | None
    groundtruth_source: str | None
    notes: tuple[str, ...]


def plan_import(bag: Bag, settings: ImportSettings, progress: Progress) -> BagPlan:
    """Reads all of a bag but its images, and decides.

    Raises:
        InputError: no images, or several cameras and none is named; no CameraInfo; a topic that
            does not exist; tf that does not connect camera and robot; stamps that are all zero.
        OptionError: options that select no image.
    """
    cameras = find_cameras(bag)
    chosen = choose_camera(bag, cameras, settings.camera)
    odometry_topic = find_odometry(bag, settings.odometry)
    truth_topic = find_ground_truth(bag, settings.groundtruth)
    topics = (chosen.topic, chosen.info_topic, odometry_topic, truth_topic)
    survey = survey_bag(bag, [topic for topic in topics if topic is not None], progress)
    tree, max_gap = survey.tree, settings.max_gap or MAX_GAP
    camera = _camera(bag, chosen, survey, settings)
    odometry = _pose_source(survey, odometry_topic, settings.odometry, max_gap)
    truth = _pose_source(survey, truth_topic, settings.groundtruth, max_gap)
    if odometry is None and settings.odometry is None:
        odometry = odometry_of_tf(tree, max_gap)
    base = _base(tree, chosen, odometry, settings)
    base_from_camera = _mount(tree, base, chosen, settings)
    notes = _notes(cameras, chosen, base_from_camera)
    stamps = survey.image_stamps(chosen.topic)
    arrivals = _in_time(stamps, settings, notes)
    # Without a name of the robot's frame, all poses are taken to be of the body.
    body = base if base is not None else "" if settings.mount is not None else chosen.frame
    at_images: Trajectory | None = None
    if odometry is not None:
        arrivals, at_images = _with_odometry(
            _of_frame(tree, odometry, body), stamps, arrivals, settings, notes
        )
    elif settings.distance is not None or settings.angle is not None:
        raise OptionError("--distance and --angle need odometry, and the bag holds none")
    else:
        notes.append("no odometry")
    return BagPlan(
        camera_topic=chosen,
        arrivals=arrivals,
        stamps=stamps[arrivals],
        camera=camera,
        base_from_camera=base_from_camera,
        base=base,
        odometry=at_images,
        groundtruth=_true_poses(tree, truth, body, stamps[arrivals], max_gap, notes),
        odometry_source=None if odometry is None else odometry.text,
        groundtruth_source=None if truth is None else truth.text,
        notes=tuple(notes),
    )


def odometry_of_tf(tree: TransformTree, max_gap: float) -> PoseSource | None:
    """The robot's odometry as /tf has it: the one frame below ``odom``; None where it has none.

    Raises:
        InputError: there are several.
    """
    pairs = odometry_frames(tree)
    if len(pairs) > 1:
        names = ", ".join(quoted(f"{parent}:{child}") for parent, child in pairs)
        raise InputError(
            tree.source,
            f"tf holds odometry of {len(pairs)} frames: {names}",
            "choose by --odometry",
        )
    return _of_tf(tree, *pairs[0], max_gap) if pairs else None


def _pose_source(
    survey: Survey, topic: str | None, wanted: str | None, max_gap: float
) -> PoseSource | None:
    if topic is not None:
        return PoseSource(topic, survey.poses_of(topic).child, survey.track(topic))
    if wanted is not None and is_frame_pair(wanted):
        return _of_tf(survey.tree, *frame_pair(wanted), max_gap)
    return None


def _of_tf(tree: TransformTree, parent: str, child: str, max_gap: float) -> PoseSource:
    return PoseSource(f"{parent}:{child}", child, tree.track(parent, child, max_gap))


def _camera(bag: Bag, chosen: CameraTopic, survey: Survey, settings: ImportSettings) -> Camera:
    width, height = chosen.size
    focal = settings.focal_length(width)
    if focal is not None:
        centre = ((width - 1) / 2.0, (height - 1) / 2.0)
        return Camera("SIMPLE_PINHOLE", width, height, (focal, *centre))
    info = None if chosen.info_topic is None else survey.infos.get(chosen.info_topic)
    if info is None:
        raise InputError(
            bag.path,
            f"holds no CameraInfo for {quoted(chosen.topic)}",
            "give its focal length: --focal or --fov",
        )
    where = f"{bag.path}, topic {quoted(chosen.info_topic)}"
    return camera_of_info(info, chosen.size, where, rectified=chosen.is_rectified)


def _base(
    tree: TransformTree,
    chosen: CameraTopic,
    odometry: PoseSource | None,
    settings: ImportSettings,
) -> str | None:
    """The robot's frame; None where the body is the camera."""
    frame = settings.base
    if frame is None and odometry is not None:
        frame = odometry.child or base_of_tf(tree)
        if frame is None and settings.mount is None:
            raise InputError(
                tree.source,
                f"nothing says which frame the poses of {quoted(odometry.text)} are of",
                "name it with --base",
            )
    if frame is None:
        frame = base_of_tf(tree)
    return None if frame == chosen.frame else frame


def _mount(
    tree: TransformTree, base: str | None, chosen: CameraTopic, settings: ImportSettings
) -> FloatArray | None:
    """``base_from_camera``; None where the body is the camera."""
    if settings.mount is not None:
        return base_from_camera_mount(settings.mount[:3], settings.mount[3:])
    if base is None:
        return None
    try:
        return tree.fixed(base, chosen.frame)
    except InputError as error:
        raise InputError(
            error.path,
            error.reason,
            "name the robot's frame with --base, or give the camera's place on it with --mount",
        ) from error


def _notes(
    cameras: Sequence[CameraTopic], chosen: CameraTopic, base_from_camera: FloatArray | None
) -> list[str]:
    notes = [
        f"{quoted(other.topic)}: the same images, encoded; not read"
        for other in cameras
        if other.topic.startswith(f"{chosen.topic}/") and not other.is_depth
    ]
    if chosen.is_rectified:
        notes.append("the images are rectified: the camera is a pinhole, of the projection matrix")
    if base_from_camera is not None and "optical" not in chosen.frame:
        angle = math.degrees(math.acos(min(1.0, abs(float(base_from_camera[2, 2])))))
        if angle <= LOOKS_UP_DEG:
            notes.append(
                f"the camera looks straight up or down: an image's frame looks along z, "
                f"{quoted(chosen.frame)} may be one that looks along x"
            )
    return notes


def _in_time(stamps: IntArray, settings: ImportSettings, notes: list[str]) -> IntArray:
    """Which images are looked at, in order of time."""
    order = np.argsort(stamps, kind="stable")
    is_first = np.append(True, np.diff(stamps[order]) > 0)
    if not np.all(is_first):
        notes.append(
            f"{np.count_nonzero(~is_first)} images with the stamp of another were left out"
        )
    order = order[is_first]
    seconds = (stamps[order] - stamps[order[0]]) / NANOSECONDS
    end = math.inf if settings.end is None else settings.end
    inside = order[(seconds >= (settings.start or 0.0)) & (seconds <= end)]
    if len(inside) == 0:
        raise OptionError(
            f"no image lies between --start and --end: there are {seconds[-1]:.3f} s of images"
        )
    return np.asarray(inside[:: settings.every or 1], dtype=np.int64)


def _of_frame(tree: TransformTree, source: PoseSource, body: str) -> PoseTrack:
    """The poses of the body, which may be another frame of the same robot."""
    if not body or source.child in {"", body}:
        return source.track
    return source.track.moved(np.eye(4), tree.fixed(source.child, body))


def _with_odometry(
    track: PoseTrack,
    stamps: IntArray,
    arrivals: IntArray,
    settings: ImportSettings,
    notes: list[str],
) -> tuple[IntArray, Trajectory]:
    """The images whose pose odometry knows, and these poses."""
    max_gap = settings.max_gap or MAX_GAP
    poses, known = track.at(stamps[arrivals], max_gap)
    if not np.any(known):
        first, last = _seconds(stamps[arrivals[[0, -1]]])
        start, end = _seconds(track.stamps[[0, -1]])
        raise StageError(
            f"no image lies within the odometry's time: images from {first:.3f} to {last:.3f} s, "
            f"odometry from {start:.3f} to {end:.3f} s (--odometry none does without)"
        )
    if not np.all(known):
        notes.append(
            f"{np.count_nonzero(~known)} of {len(known)} images lie outside of the odometry's "
            f"time, or where it has a gap of more than {max_gap:g} s: left out"
        )
    arrivals, poses = arrivals[known], poses[known]
    if settings.distance is not None or settings.angle is not None:
        angle = None if settings.angle is None else math.radians(settings.angle)
        taken = moved_enough(poses, settings.distance, angle)
        arrivals, poses = arrivals[taken], poses[taken]
    return arrivals, Trajectory(_seconds(stamps[arrivals]), poses)


def _true_poses(
    tree: TransformTree,
    truth: PoseSource | None,
    body: str,
    stamps: IntArray,
    max_gap: float,
    notes: list[str],
) -> Trajectory | None:
    if truth is None:
        return None
    poses, known = _of_frame(tree, truth, body).at(stamps, max_gap)
    if not np.all(known):
        notes.append(f"ground truth for {np.count_nonzero(known)} of {len(known)} images")
    return Trajectory(_seconds(stamps[known]), poses[known]) if np.any(known) else None


def _seconds(stamps: IntArray) -> FloatArray:
    return np.asarray(stamps / NANOSECONDS, dtype=np.float64)
