"""Given poses against photos: read wrongly they are noticed, read rightly they are not."""

import logging
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.geometry.planarity import note_on_speed
from pipelines.geometry.pose import inverse, pose_from_quaternion, quaternion_of
from pipelines.geometry.trajectory import Trajectory, format_tum, read_tum
from pipelines.reconstruct.known_poses import pair_poses
from pipelines.reconstruct.pose_check import note_on_poses
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.stage import reconstruct
from tests.reconstruct_samples import SAMPLES

ELEVATORS = SAMPLES / "elevators" / "map"
TRUTH = read_tum(ELEVATORS / "groundtruth.txt")


@pytest.fixture(autouse=True)
def _warnings_are_said(caplog: pytest.LogCaptureFixture) -> None:
    # Commands with --quiet, which other tests run, silence the library.
    caplog.set_level(logging.WARNING, logger="pipelines")


@pytest.fixture(scope="module")
def data() -> Dataset:
    return load_dataset(ELEVATORS)


def mirrored(poses: FloatArray, axis: int) -> FloatArray:
    mirror = np.eye(4)
    mirror[axis, axis] = -1.0
    return mirror @ poses @ mirror


def w_first(poses: FloatArray) -> FloatArray:
    return pose_from_quaternion(poses[:, :3, 3], np.roll(quaternion_of(poses), 1, axis=-1))


def test_true_poses_and_odometry_agree_with_the_photos(data: Dataset) -> None:
    assert data.odometry is not None
    for trajectory in (TRUTH, data.odometry):
        assert note_on_poses(data, pair_poses(data, trajectory, Path("x"))) is None


@pytest.mark.parametrize(
    ("poses", "named"),
    [
        (mirrored(TRUTH.poses, 1), "left-handed"),
        (mirrored(TRUTH.poses, 0), "left-handed"),
        (w_first(TRUTH.poses), "w first"),
        (inverse(TRUTH.poses), "the inverse"),
    ],
    ids=["y mirrored", "x mirrored", "w first", "inverse"],
)
def test_poses_that_mean_something_else_are_named(
    data: Dataset, poses: FloatArray, named: str
) -> None:
    trajectory = Trajectory(TRUTH.timestamps, poses)
    note = note_on_poses(data, pair_poses(data, trajectory, Path("x")))
    assert note is not None
    assert "the photos do not agree with these poses" in note
    assert named in note


def test_poses_of_the_camera_are_named(data: Dataset) -> None:
    camera = TRUTH.poses @ data.body_from_camera
    for turned, named in ((np.eye(4), "[mount]"), (np.diag([1.0, -1.0, -1.0, 1.0]), "OpenGL")):
        part = data
        if named == "OpenGL":
            part = Dataset(**{**vars(data), "base_from_camera": None})
        trajectory = Trajectory(TRUTH.timestamps, camera @ turned)
        note = note_on_poses(part, pair_poses(part, trajectory, Path("x")))
        assert note is not None
        assert named in note


def test_millimetres_are_noticed_by_their_speed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert note_on_speed(TRUTH.timestamps, TRUTH.poses[:, :3, 3]) is None
    large = TRUTH.poses.copy()
    large[:, :3, 3] *= 1000.0
    path = tmp_path / "poses.txt"
    path.write_text(format_tum(Trajectory(TRUTH.timestamps, large)), encoding="utf-8")
    with caplog.at_level(logging.WARNING):
        reconstruct(ELEVATORS, tmp_path / "r", ReconstructSettings("poses", poses=path))
    (said,) = [message for message in caplog.messages if "millimetres" in message]
    assert said.startswith(f"{path}: moves by ")
