"""Sessions: one a robot, each with a localizer of its own. Nothing here knows of HTTP.

The images of a session are taken one after the other, in the order in which they were handed over,
by a thread of its own; sessions run beside each other. What they share, the scene and the photos as
they are compared, none of them changes.
"""

import logging
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError, LfnavError, OptionError, StageError
from pipelines.dataset.images import decode_image, image_header
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.localize.localizer import Localizer, check_world_settings, region_of
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.render.devices import Device
from pipelines.serve.answers import answer_of
from pipelines.serve.limits import MOST_WAITING, Limits, RateLimit
from pipelines.serve.robot_camera import RobotCamera

# How errors name what came with a request.
IMAGE = "the image"

_log = logging.getLogger(__name__)


class NoSuchSessionError(LfnavError):
    """There is no session of this name, or it belongs to somebody else."""


class ConflictError(LfnavError):
    """A request that does not follow on those before it."""


class BusyError(LfnavError):
    """Too much at once; ``wait`` is the seconds after which to try again."""

    def __init__(self, text: str, wait: float = 1.0) -> None:
        super().__init__(text)
        self.wait = wait


@dataclass(frozen=True)
class SessionRequest:
    """What a client says of its robot; what it leaves out is the server's.

    Attributes:
        name: for people.
        seed: of the filter's random numbers, not negative.
        start: ``(D,)`` where the robot may be at first, metres and radians; None: anywhere.
        start_position_sigma: standard deviation around it, metres.
        start_heading_sigma: the same of the heading, radians.
        area: x_min, x_max, y_min, y_max where the robot may be, metres.
        camera: of the robot.
    """

    name: str = ""
    seed: int = 0
    start: tuple[float, ...] | None = None
    start_position_sigma: float | None = None
    start_heading_sigma: float | None = None
    area: tuple[float, float, float, float] | None = None
    camera: RobotCamera | None = None

    def settings(self, common: LocalizerSettings) -> LocalizerSettings:
        """The server's settings with those of the request.

        Raises:
            OptionError: values that the filter does not take.
        """
        names = ("start", "start_position_sigma", "start_heading_sigma", "area")
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(common, **given)


@dataclass(frozen=True)
class Motion:
    """What the robot knows of its motion with an image; nothing where both are None.

    Attributes:
        increment: ``(D,)`` since the image before, as ``Localizer.step`` takes it.
        pose: ``(4, 4)`` by odometry, in a frame of its own.
    """

    increment: FloatArray | None = None
    pose: FloatArray | None = None


class Session:
    """One robot: its localizer, and the thread that takes its images.

    Args:
        owner: who made it.
        request: what was asked for.
        camera: of the robot.
        make: makes the localizer; called by the session's thread.
        areas: names of the world's areas; none in a scene.
        limits: of images.

    Attributes:
        identifier: a name that nobody guesses.
        ready: the localizer, when it is made; or why it was not.
    """

    def __init__(
        self,
        owner: str,
        request: SessionRequest,
        camera: RobotCamera,
        make: Callable[[], Localizer],
        areas: tuple[str, ...],
        limits: Limits,
    ) -> None:
        self.identifier = secrets.token_urlsafe(12)
        self.owner, self.request, self.camera = owner, request, camera
        self._areas, self._limits = areas, limits
        self._rate = RateLimit(limits.rate)
        self._lock = threading.Lock()
        self._waiting, self._used = 0, time.monotonic()
        self._closed = False
        self._images, self._status = 0, ""
        self._stamp: float | None = None
        self._pose: FloatArray | None = None
        self._thread = ThreadPoolExecutor(1, "session")
        self.ready: Future[Localizer] = self._thread.submit(self._make, make)

    @property
    def idle_seconds(self) -> float:
        """Since it was last asked something; 0 while it works."""
        with self._lock:
            return 0.0 if self._waiting else time.monotonic() - self._used

    def describe(self) -> dict[str, Any]:
        """The session in plain JSON types."""
        return {
            "session": self.identifier,
            "name": self.request.name,
            "seed": self.request.seed,
            "images": self._images,
            "status": self._status or None,
            "stamp": self._stamp,
            "idle_seconds": self.idle_seconds,
            "camera": self.camera.to_dict(),
        }

    @contextmanager
    def place(self) -> Iterator[None]:
        """A place for one image, from before it is received until it is answered.

        Raises:
            BusyError: too many images wait already, or came in too short a time.
        """
        with self._lock:
            if self._waiting >= MOST_WAITING:
                raise BusyError(f"{MOST_WAITING} images of this session are being taken already")
            wait = self._rate.take()
            if wait > 0.0:
                raise BusyError(
                    f"more than {self._limits.rate:g} images a second come to this session", wait
                )
            self._waiting += 1
        try:
            yield
        finally:
            with self._lock:
                self._waiting -= 1
                self._used = time.monotonic()

    def locate(self, data: bytes, motion: Motion, stamp: float | None) -> "Future[dict[str, Any]]":
        """Hands an image over; it is taken after those that were handed over before.

        Args:
            data: JPEG or PNG.
            motion: since the image before.
            stamp: when it was taken, seconds; None: unknown.

        Returns:
            The answer in plain JSON types, or as its error: InputError or OptionError for what is
            wrong with the request (the filter is then as it was), ConflictError for a stamp that
            goes back, NoSuchSessionError where the session was closed meanwhile.

        Raises:
            NoSuchSessionError: it was closed.
        """
        try:
            return self._thread.submit(self._locate, data, motion, stamp)
        except RuntimeError as error:
            raise _closed() from error

    def close(self) -> None:
        """Takes no more images; those that wait are refused."""
        self._closed = True
        self._thread.shutdown(wait=False)

    def _make(self, make: Callable[[], Localizer]) -> Localizer:
        try:
            return make()
        except InputError as error:
            raise _unreadable(error) from error

    def _locate(self, data: bytes, motion: Motion, stamp: float | None) -> dict[str, Any]:
        if self._closed:
            raise _closed()
        localizer = self.ready.result()
        if stamp is not None and self._stamp is not None and stamp < self._stamp:
            raise ConflictError(f"stamp {stamp!r} is before the last image's, {self._stamp!r}")
        image = self._decoded(data)
        record = self._step(localizer, image, self._increment(localizer, motion), stamp or 0.0)
        self._pose = motion.pose
        self._stamp = stamp if stamp is not None else self._stamp
        self._images, self._status = self._images + 1, record.status
        about = {"session": self.identifier, "image": self._images - 1, "stamp": stamp}
        return {**about, **answer_of(record, localizer.space, self._areas, localizer.notes)}

    def _step(
        self, localizer: Localizer, image: ImageArray, increment: FloatArray | None, stamp: float
    ) -> FrameRecord:
        """The filter's step. After one that failed midway nobody knows what the filter believes."""
        try:
            return localizer.step(image, increment, stamp)
        except OptionError:
            raise
        except InputError as error:
            self._closed = True
            raise _unreadable(error) from error
        except Exception:
            self._closed = True
            raise

    def _decoded(self, data: bytes) -> ImageArray:
        """The image, if it is one of the session's camera; its header says so, for a start."""
        camera = self.camera.camera
        header = image_header(data, IMAGE)
        if (header.width, header.height) != (camera.width, camera.height):
            raise InputError(
                IMAGE,
                f"has {header.width}x{header.height} pixels, and the session's camera "
                f"{camera.width}x{camera.height}",
            )
        return decode_image(data, IMAGE)

    def _increment(self, localizer: Localizer, motion: Motion) -> FloatArray | None:
        """The motion since the last image that was taken."""
        if motion.pose is None:
            return motion.increment
        if self._pose is None:
            return None
        return localizer.space.increment(self._pose, motion.pose)


class Sessions:
    """All sessions of a scene or a world.

    Args:
        scene: where robots are localized.
        settings: of the filter; a session may have a start and an area of its own.
        camera: of sessions that name none; None: each has to.
        limits: of sessions and images.

    Raises:
        OptionError: settings that this scene does not take, or a GPU.
        InputError: a photo of the scene cannot be decoded.
    """

    def __init__(
        self,
        scene: Scene | OpenWorld,
        settings: LocalizerSettings,
        camera: RobotCamera | None = None,
        limits: Limits | None = None,
    ) -> None:
        if settings.device is Device.GPU:
            raise OptionError("sessions share the photos on the CPU, not on a GPU")
        if settings.uses_pnp:
            raise OptionError("sessions are localized in by the filter alone, without PnP")
        self.scene, self.camera = scene, camera
        self.settings = replace(settings, device=Device.CPU)
        self.space = settings.state_space
        self.limits = Limits() if limits is None else limits
        region_of(scene, settings)
        self._model: MeasurementModel | None = None
        self.areas: tuple[str, ...] = ()
        if isinstance(scene, OpenWorld):
            check_world_settings(self.settings, None)
            self.areas = scene.area_map.names
        else:
            self._model = MeasurementModel.of_scene(scene, np.eye(4), self.settings)
        self._lock = threading.Lock()
        self._sessions: dict[str, Session] = {}

    def create(self, owner: str, request: SessionRequest) -> Session:
        """Makes a session; its localizer is made beside, see ``Session.ready``.

        Args:
            owner: who may use it.
            request: what it is to be.

        Raises:
            OptionError: no camera is known, or values that the filter does not take.
            BusyError: there are as many sessions as may be.
        """
        camera = self.camera if request.camera is None else request.camera
        if camera is None:
            raise OptionError("the request names no camera, and the server has none for all")
        pixels = camera.camera.width * camera.camera.height
        if pixels > self.limits.pixels:
            raise OptionError(
                f"the camera has {pixels} pixels; at most {self.limits.pixels} are taken"
            )
        settings = request.settings(self.settings)
        region_of(self.scene, settings)
        robot = camera

        def make() -> Localizer:
            model = None if self._model is None else self._model.mounted(robot.body_from_camera)
            rng = np.random.default_rng(request.seed)
            return Localizer(
                self.scene, robot.camera, robot.body_from_camera, settings, rng, model, robot.mask
            )

        with self._lock:
            if len(self._sessions) >= self.limits.sessions:
                raise BusyError(
                    f"there are {self.limits.sessions} sessions already, as many as may be",
                    self.limits.idle_seconds,
                )
            session = Session(owner, request, camera, make, self.areas, self.limits)
            self._sessions[session.identifier] = session
        return session

    def find(self, owner: str, identifier: str) -> Session:
        """The session of a name.

        Raises:
            NoSuchSessionError: none of this owner's.
        """
        with self._lock:
            session = self._sessions.get(identifier)
        if session is None or session.owner != owner:
            raise NoSuchSessionError("there is no such session; it may have been idle too long")
        return session

    def of(self, owner: str) -> tuple[Session, ...]:
        """The sessions of an owner, the oldest first."""
        with self._lock:
            return tuple(one for one in self._sessions.values() if one.owner == owner)

    def close(self, session: Session) -> None:
        """Ends a session, whether or not it has ended already."""
        with self._lock:
            self._sessions.pop(session.identifier, None)
        session.close()

    def close_idle(self) -> int:
        """Ends the sessions that were idle for too long, and says how many."""
        with self._lock:
            everyone = tuple(self._sessions.values())
        idle = [one for one in everyone if one.idle_seconds > self.limits.idle_seconds]
        for session in idle:
            self.close(session)
        return len(idle)

    def close_all(self) -> None:
        """Ends all sessions."""
        with self._lock:
            everyone = tuple(self._sessions.values())
        for session in everyone:
            self.close(session)


def _closed() -> NoSuchSessionError:
    return NoSuchSessionError("the session was closed")


def _unreadable(error: InputError) -> StageError:
    """What a client is told: which file of the server's it was is not its business."""
    _log.error("a session ended: %s", error)
    return StageError("the scene model cannot be read; the server's log says why")
