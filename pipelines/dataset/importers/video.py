"""The frames of a video file, as images of a data set.

OpenCV decodes through FFmpeg. What a video states about its length is not believed: the number of
images is bounded by ``max_frames``, their size by the cap for all images.
"""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import Progress
from pipelines.dataset.images import MAX_PIXELS, encode_jpeg, encode_png
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.camera import Camera

DEFAULT_MAX_FRAMES = 1000
JPEG_QUALITY = 95
# Share of the stated frames that may be missing at the end: the number is often an estimate.
TOLERATED_LOSS = 0.02
# OpenCV's level of talking at which it says nothing.
SILENT = 0


def extract_frames(
    source: Path, folder: Path, settings: ImportSettings, progress: Progress
) -> Recording:
    """Decodes a video and writes its frames into ``folder/rgb``, which exists.

    Raises:
        InputError: not a video, nothing in it can be decoded, or the frames are too large.
    """
    suffix = ".png" if settings.image_format == "png" else ".jpg"
    limit = DEFAULT_MAX_FRAMES if settings.max_frames is None else settings.max_frames
    frames: list[SourceFrame] = []
    size = (0, 0)
    with _opened(source) as capture:
        stated = _stated_frames(capture)
        selection = _Selection(source, capture, settings)
        for moment in progress(selection.moments(), "decoding frames", stated):
            if len(frames) == limit:
                break
            image = _retrieved(source, capture, moment)
            size = (image.shape[1], image.shape[0])
            rgb = np.ascontiguousarray(image[:, :, ::-1])
            data = encode_png(rgb) if suffix == ".png" else encode_jpeg(rgb, JPEG_QUALITY)
            name = f"{IMAGE_FOLDER}/{moment.index:06d}{suffix}"
            (folder / name).write_bytes(data)
            frames.append(SourceFrame(folder / name, name, moment.time))
    if not frames:
        raise InputError(source, "holds no frame that can be decoded")
    notes = selection.notes(stated, len(frames), limit)
    return Recording(tuple(frames), _cameras(settings, size), None, notes=notes)


def _cameras(settings: ImportSettings, size: tuple[int, int]) -> tuple[Camera, ...]:
    focal = settings.focal_length(size[0])
    if focal is None:
        return ()
    return (Camera("SIMPLE_PINHOLE", *size, (focal, (size[0] - 1) / 2.0, (size[1] - 1) / 2.0)),)


@dataclass(frozen=True)
class _Moment:
    """A frame that was chosen: its number in the video and its time in seconds."""

    index: int
    time: float


class _Selection:
    """Walks through a video and stops at the frames that are wanted."""

    def __init__(self, source: Path, capture: Any, settings: ImportSettings) -> None:
        self.source, self.capture = source, capture
        self.every = settings.every or 1
        self.period = 0.0 if settings.fps is None else 1.0 / settings.fps
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        self.frame_time = 1.0 / rate if math.isfinite(rate) and rate > 0.0 else 0.0
        self.seen = 0
        self.ended = False

    def moments(self) -> Iterator[_Moment]:
        """The chosen frames; the capture stands at the one that was yielded last."""
        last, due = -math.inf, -math.inf
        while self.capture.grab():
            time = self._time_after(last)
            index, self.seen, last = self.seen, self.seen + 1, time
            # Half a frame's time of tolerance keeps rounding from skipping a frame too many.
            if index % self.every or time < due - self.frame_time / 2.0:
                continue
            # After a gap the sampling starts again.
            start = time if due == -math.inf else max(due, time - self.frame_time)
            due = start + self.period
            yield _Moment(index, time)
        self.ended = True

    def _time_after(self, last: float) -> float:
        time = float(self.capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
        if math.isfinite(time) and time > last:
            return time
        if last == -math.inf:
            return 0.0
        if self.frame_time == 0.0:
            raise InputError(self.source, "states neither times nor a frame rate")
        return last + self.frame_time

    def notes(self, stated: int | None, taken: int, limit: int) -> tuple[str, ...]:
        """What was left out and why."""
        if not self.ended:
            text = f"stopped after {limit} images, {self.seen - 1} frames into the video"
            return (f"{text}; --max-frames takes more, --every and --fps take fewer of them",)
        if stated is not None and self.seen < (1.0 - TOLERATED_LOSS) * stated - 1.0:
            return (f"only {self.seen} of the {stated} stated frames could be decoded",)
        return (f"{taken} of {self.seen} frames",)


def _stated_frames(capture: Any) -> int | None:
    count = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    return int(count) if math.isfinite(count) and 0.0 < count < 1e9 else None


def _retrieved(source: Path, capture: Any, moment: _Moment) -> Any:
    ok, image = capture.retrieve()
    if not ok or image is None or image.ndim != 3:
        raise InputError(source, f"frame {moment.index} cannot be decoded")
    return image


def _set_log_level(level: int) -> int:
    """Sets how much OpenCV says on stderr, and returns what it was."""
    # OpenCV 5 has moved it.
    setter = cv2.setLogLevel if hasattr(cv2, "setLogLevel") else cv2.utils.logging.setLogLevel
    return int(setter(level))


@contextmanager
def _opened(source: Path) -> Iterator[Any]:
    """OpenCV's capture of a video file, with its talk on stderr switched off."""
    if not source.is_file():
        raise InputError(source, "is not a file" if source.exists() else "does not exist")
    # Read by OpenCV when it first uses FFmpeg, which else reports damage on stderr by itself.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    level = _set_log_level(SILENT)
    capture: Any = None
    try:
        # FFmpeg alone: other backends would take the name for a pattern of file names.
        capture = cv2.VideoCapture(str(source.absolute()), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise InputError(source, "is no video, is damaged, or its codec is not supported")
        width = float(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = float(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if not 0.0 < width * height <= MAX_PIXELS:
            raise InputError(source, f"has frames of {width:g}x{height:g} pixels")
        yield capture
    except cv2.error as error:
        raise InputError(source, f"cannot be decoded ({error.err or 'OpenCV failed'})") from error
    finally:
        if capture is not None:
            capture.release()
        _set_log_level(level)
