"""Messages in, poses out: image by image, in a thread of its own, and never late.

Nothing here is of ROS: messages are taken by their fields, and what is to be published is handed to
``Outputs``. Whoever receives messages calls the methods ``on_...`` from any thread.
"""

import threading
import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, LfnavError, quoted, reason_of
from pipelines.localize.run import FrameRecord
from pipelines.ros.camera_info import camera_of_info, info_key, is_rectified
from pipelines.ros.health import Health
from pipelines.ros.image_message import image_of_message, message_size
from pipelines.ros.live_localizer import LiveLocalizer, MountedCamera
from pipelines.ros.newest_image import NewestQueue
from pipelines.ros.node_settings import NodeSettings
from pipelines.ros.pose_publishing import KnownPose, PosePublishing, known_pose
from pipelines.ros.pose_track import NANOSECONDS, frame_name, stamp_of
from pipelines.ros.transform_buffer import TransformBuffer, TransformError

# A clock that goes back by more than this was set back; by less, messages overtook each other.
CLOCK_JUMP = 0.5
# How often the loop looks whether it is to end, seconds.
POLL = 0.2


class Outputs(Protocol):
    """What the loop hands over, from its own thread."""

    def pose(self, pose: KnownPose) -> None:
        """The pose of a new image."""

    def transform(self, map_from_odom: FloatArray, stamp: int) -> None:
        """The transform at the moment ``stamp`` (ns) of an image: new, or repeated."""

    def frame(self, record: FrameRecord, stamp: int) -> None:
        """The belief after an image, whether a pose is known or not."""

    def say(self, text: str, *, is_error: bool) -> None:
        """A line for the log."""


@dataclass(frozen=True)
class _Job:
    message: Any
    generation: int


class LocalizationLoop:
    """Localizes the newest image, whenever the one before is done.

    Args:
        localizer: of the scene.
        settings: topics, frames, times.
        outputs: what is published.
        health: counts images.
    """

    def __init__(
        self, localizer: LiveLocalizer, settings: NodeSettings, outputs: Outputs, health: Health
    ) -> None:
        self.transforms = TransformBuffer()
        self._odometry = TransformBuffer()
        self._localizer, self._settings = localizer, settings
        self._outputs, self._health = outputs, health
        self._queue: NewestQueue[_Job] = NewestQueue()
        self._publishing = PosePublishing()
        self._has_file = localizer.is_mounted
        self._is_rectified = is_rectified(settings.image_topic)
        self._info: Any = None
        self._mounted_as: tuple[Any, ...] | None = None
        self._newest = -1
        self._generation = 0
        # The filter is changed by one thread at a time.
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begins to localize."""
        self._queue = NewestQueue()
        self._publishing = PosePublishing()
        self._health.start(time.monotonic())
        self._thread = threading.Thread(
            target=self._run, args=(self._queue,), name="localization", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Ends after the image at hand; what was known of the pose is kept for ``start``."""
        self._queue.close()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def on_image(self, message: Any) -> None:
        """A sensor_msgs/Image or CompressedImage."""
        stamp = stamp_of(message)
        self.note("stamp", "" if stamp else f"images on {self._settings.image_topic} have no time")
        if not stamp:
            return
        if stamp < self._newest - CLOCK_JUMP * NANOSECONDS:
            self.clock_was_set_back()
        if stamp <= self._newest:
            return
        self._newest = stamp
        given_up = self._queue.put(_Job(message, self._generation))
        self._health.arrived(time.monotonic(), gave_up=given_up is not None)
        if given_up is not None:
            self._repeat(stamp)

    def on_camera_info(self, message: Any) -> None:
        """A sensor_msgs/CameraInfo."""
        self._info = message

    def on_odometry(self, message: Any) -> None:
        """A nav_msgs/Odometry; its child frame is taken for the robot's."""
        settings, stamp = self._settings, stamp_of(message)
        is_pose = self._odometry.add_pose(
            settings.odom_frame_id, settings.base_frame_id, stamp, message.pose.pose
        )
        self.note("odometry", "" if is_pose else "a message of odometry holds no pose")

    def on_transforms(self, message: Any, *, is_static: bool) -> None:
        """A tf2_msgs/TFMessage."""
        refused = self.transforms.add(message.transforms, is_static=is_static)
        names = ", ".join(map(quoted, refused))
        self.note("transform", f"tf of {names} is no transform" if refused else "")

    def set_pose(self, map_from_base: FloatArray, covariance: FloatArray) -> None:
        """Goes on around a pose: ``(4, 4)``, with covariance ``(6, 6)``.

        Raises:
            OptionError: numbers that are no pose; the filter is then as it was.
        """
        with self._lock:
            self._localizer.set_pose(map_from_base, covariance)
            self._publishing.update(None)

    def search(self) -> None:
        """Forgets the pose, and searches the whole area."""
        with self._lock:
            self._localizer.search()
            self._publishing.update(None)

    def clock_was_set_back(self) -> None:
        """Forgets what is later than now: odometry, images, and the pose."""
        self._generation += 1
        self._newest = -1
        self._queue.clear()
        self.transforms.clear()
        self._odometry.clear()
        self._outputs.say("the clock was set back: starting again", is_error=False)
        with self._lock:
            self._localizer.reset()
            self._publishing.update(None)

    def note(self, kind: str, text: str) -> None:
        """Says that something is wrong, or over where ``text`` is empty: once each."""
        line = self._health.fault(kind, text)
        if line is not None:
            self._outputs.say(line, is_error=bool(text))

    def check(self) -> None:
        """Looks whether the camera is silent; to be called now and then."""
        line = self._health.check_silence(time.monotonic())
        if line is not None:
            self._outputs.say(line, is_error=not line.startswith("over"))

    def _run(self, queue: NewestQueue[_Job]) -> None:
        while True:
            found = queue.get(POLL)
            if found is not None:
                self._take(*found)
            elif queue.is_closed:
                return

    def _take(self, job: _Job, arrival: float) -> None:
        """Localizes one image; whatever is wrong with it is said, and the next may be better."""
        stamp = stamp_of(job.message)
        try:
            image = image_of_message(job.message, self._settings.image_topic)
            with self._lock:
                self._mount(job.message)
                odom_from_base = self._odometry_at(stamp)
                if job.generation != self._generation:
                    return
                name = f"{stamp}"
                seconds = stamp / NANOSECONDS
                record = self._localizer.step(image, seconds, name, odom_from_base)
                space = self._localizer.space
                pose = self._publishing.update(known_pose(record, space, stamp, odom_from_base))
        except TransformError as error:
            self._fail("tf", str(error), stamp)
            return
        except LfnavError as error:
            self._fail("image", str(error), stamp)
            return
        except Exception as error:  # noqa: BLE001
            # A node that dies leaves the robot without a pose; the log has what happened.
            text = f"internal error: {type(error).__name__}: {reason_of(error)}"
            self._fail("defect", text, stamp)
            return
        self._outcome("", "")
        if pose is not None:
            self._outputs.transform(pose.map_from_odom, stamp)
            self._outputs.pose(pose)
        self._outputs.frame(record, stamp)
        self._health.localized(time.monotonic() - arrival, record.status, record.confidence)

    def _fail(self, kind: str, text: str, stamp: int) -> None:
        self._outcome(kind, text)
        self._repeat(stamp)

    def _outcome(self, kind: str, text: str) -> None:
        """Notes what went wrong with an image; what went wrong with one before is over."""
        for other in ("tf", "image", "defect"):
            self.note(other, text if other == kind else "")

    def _repeat(self, stamp: int) -> None:
        known = self._publishing.repeated(stamp)
        if known is not None:
            self._outputs.transform(known, stamp)

    def _odometry_at(self, stamp: int) -> FloatArray:
        settings = self._settings
        buffer = self._odometry if settings.odometry_topic else self.transforms
        return buffer.wait(
            settings.odom_frame_id, settings.base_frame_id, stamp, settings.transform_timeout
        )

    def _mount(self, message: Any) -> None:
        """Takes the camera of the messages where no file says it, and whenever it changes.

        Raises:
            InputError: no CameraInfo yet, or one of another camera.
            TransformError: tf does not say where the camera sits.
        """
        if self._has_file:
            return
        settings, info = self._settings, self._info
        topic = settings.info_topic
        if info is None:
            raise InputError(topic, "no CameraInfo yet", "give a camera.toml with --camera")
        frame = frame_name(message.header.frame_id)
        key = (*info_key(info), frame)
        if key == self._mounted_as:
            return
        if not frame:
            raise InputError(settings.image_topic, "the images do not say their frame")
        size = message_size(message, settings.image_topic)
        camera = camera_of_info(info, size, topic, rectified=self._is_rectified)
        base_from_camera = self.transforms.wait(
            settings.base_frame_id, frame, stamp_of(message), settings.transform_timeout
        )
        self._localizer.mount(MountedCamera(camera, base_from_camera))
        self._mounted_as = key


def pose_of_message(pose: Any) -> FloatArray:
    """``(4, 4)`` of a geometry_msgs/Pose.

    Raises:
        TransformError: it is none.
    """
    buffer = TransformBuffer()
    if not buffer.add_pose("to", "from", 0, pose):
        raise TransformError("the pose is none: not finite, or no unit quaternion")
    return buffer.lookup("to", "from", 0)


def covariance_of_message(values: Any) -> FloatArray:
    """``(6, 6)`` of a PoseWithCovariance's list."""
    return np.array(values, dtype=np.float64).reshape(6, 6)
