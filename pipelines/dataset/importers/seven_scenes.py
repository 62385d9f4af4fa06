"""The 7-Scenes benchmark (Shotton et al. 2013): frames of an RGB-D camera with their poses.

A frame is ``frame-NNNNNN.color.png``, ``.depth.png`` (millimetres, 65535 where unknown) and
``.pose.txt`` (world_from_camera, metres).
"""

import re
from pathlib import Path

import numpy as np

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.file_content import read_text_file
from pipelines.dataset.dataset import images_in
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.pose_matrix import read_number_rows, rigid_pose
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.camera import Camera

FRAME_NAME = re.compile(r"frame-([0-9]{1,9})\.color\.(png|jpg|jpeg)")
MAX_POSE_BYTES = 64 * 1024
FRAMES_A_SECOND = 30.0
DEPTH_SCALE, DEPTH_INVALID = 1000.0, 65535
# As the benchmark states them, for its images of 640 x 480 pixels.
FOCAL, CENTRE, SIZE = 585.0, (320.0, 240.0), (640, 480)


def read_seven_scenes(source: Path, settings: ImportSettings) -> Recording:
    """Reads the folder of a sequence.

    Raises:
        InputError: no frames, poses of some of them only, or a pose that is not rigid.
        OptionError: images of another size than the benchmark's, and no focal length is given.
    """
    matches = [match for name in images_in(source) if (match := FRAME_NAME.fullmatch(name))]
    if not matches:
        raise InputError(
            source,
            "holds no frame-NNNNNN.color.png",
            "give the folder of one sequence, seq-01 for example",
        )
    frames, poses = [], []
    with_poses = any((source / f"{_stem(match)}.pose.txt").is_file() for match in matches)
    for match in matches:
        depth = source / f"{_stem(match)}.depth.png"
        frames.append(
            SourceFrame(
                source / match.string,
                f"{IMAGE_FOLDER}/{match.string}",
                int(match[1]) / FRAMES_A_SECOND,
                depth=depth if depth.is_file() else None,
            )
        )
        if with_poses:
            path = source / f"{_stem(match)}.pose.txt"
            rows = read_number_rows(path, read_text_file(path, MAX_POSE_BYTES), 4)
            poses.append(rigid_pose(path, rows, "the pose"))
    times = [frame.timestamp for frame in frames]
    if np.any(np.diff(times) <= 0.0):
        raise InputError(source, "holds two frames of the same number")
    camera, note = _camera(frames[0].file, settings)
    has_depth = any(frame.depth is not None for frame in frames)
    return Recording(
        tuple(frames),
        (camera,),
        np.stack(poses) if with_poses else None,
        depth_scale=DEPTH_SCALE if has_depth else None,
        depth_invalid=DEPTH_INVALID,
        notes=(note, f"times from the frame numbers at {FRAMES_A_SECOND:g} images a second"),
    )


def _stem(match: re.Match[str]) -> str:
    return f"frame-{match[1]}"


def _camera(image: Path, settings: ImportSettings) -> tuple[Camera, str]:
    header = read_image_header(image)
    size = (header.width, header.height)
    if size == SIZE:
        centre = CENTRE
    else:
        centre = ((header.width - 1) / 2.0, (header.height - 1) / 2.0)
        if settings.focal is None:
            raise OptionError(
                f"{image} is {size[0]}x{size[1]} pixels, the benchmark's images are 640x480: "
                "say --focal PX"
            )
    focal = FOCAL if settings.focal is None else settings.focal
    source = "the benchmark's convention" if settings.focal is None else "--focal"
    note = f"focal length {focal:g} px by {source}, for colour and depth alike"
    return Camera("SIMPLE_PINHOLE", *size, (focal, *centre)), note
