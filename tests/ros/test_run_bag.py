"""A run as a bag: read back by mcap-ros2-support, which is another program, and by the import."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.images import encode_jpeg, encode_png
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import inverse, pose_from_quaternion
from pipelines.localize.run import Run, save_run
from pipelines.ros.run_bag import export_run_to_bag
from tests.chain_samples import lfnav, succeed
from tests.localize_samples import curved_path, run_along, spatial_run

START = 1305031102.175304
TIMES: FloatArray = START + 0.5 * np.arange(6, dtype=np.float64)


def exported(folder: Path, run: Run, estimate: str | None = None) -> dict[str, list[Any]]:
    """All messages of the bag, by topic."""
    save_run(folder / "run.h5", run, overwrite=True)
    export_run_to_bag(folder / "run.h5", folder / "run.mcap", estimate, overwrite=True)
    found: dict[str, list[Any]] = {}
    with (folder / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for message in reader.iter_decoded_messages():
            found.setdefault(message.channel.topic, []).append(message)
    return found


def sample_run(**changes: Any) -> Run:
    states = curved_path(6)
    states[2] = np.nan
    truth = curved_path(6)
    truth[0] = np.nan
    own = curved_path(6) - [1.0, 0.5, 0.2]
    run = run_along(states, groundtruth=truth, odometry=own, timestamps=TIMES)
    return replace(run, **changes)


def stamp(message: Any) -> int:
    header = message.decoded_message.header
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def pose_of(pose: Any) -> FloatArray:
    place = getattr(pose, "position", None) or pose.translation
    turn = getattr(pose, "orientation", None) or pose.rotation
    return pose_from_quaternion((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))


def test_poses_and_stamps_are_those_of_the_run(tmp_path: Path) -> None:
    run = sample_run()
    found = exported(tmp_path, run)
    states = run.estimated_states()
    known = [index for index in range(6) if index != 2]
    poses = found["/amcl_pose"]
    assert [stamp(message) for message in poses] == [
        1305031102175304000 + 500_000_000 * index for index in known
    ]
    assert all(message.message.log_time == stamp(message) for message in poses)
    assert {message.decoded_message.header.frame_id for message in poses} == {"map"}
    for message, index in zip(poses, known, strict=True):
        np.testing.assert_allclose(
            pose_of(message.decoded_message.pose.pose), run.space.poses(states[index]), atol=1e-12
        )
        covariance = np.reshape(message.decoded_message.pose.covariance, (6, 6))
        np.testing.assert_array_equal(
            covariance[np.ix_([0, 1, 5], [0, 1, 5])], run.frames[index].covariance
        )
        assert np.count_nonzero(covariance) == 3
    assert [stamp(message) for message in found["/ground_truth"]] == [
        1305031102175304000 + 500_000_000 * index for index in range(1, 6)
    ]


def test_tf_leads_from_the_map_to_the_camera(tmp_path: Path) -> None:
    run = sample_run()
    assert run.odometry is not None
    found = exported(tmp_path, run)
    (static,) = found["/tf_static"][0].decoded_message.transforms
    assert (static.header.frame_id, static.child_frame_id) == ("base_link", "camera_optical_frame")
    np.testing.assert_allclose(pose_of(static.transform), run.base_from_camera, atol=1e-12)
    for index, message in enumerate(found["/tf"]):
        ways = {
            (t.header.frame_id, t.child_frame_id): pose_of(t.transform)
            for t in message.decoded_message.transforms
        }
        odometry = ways["odom", "base_link"]
        np.testing.assert_allclose(odometry, run.space.poses(run.odometry[index]), atol=1e-12)
        np.testing.assert_allclose(
            pose_of(found["/odom"][index].decoded_message.pose.pose), odometry, atol=1e-12
        )
        # Nothing is published while lost.
        assert (("map", "odom") in ways) is (index != 2)
        if index != 2:
            estimate = run.space.poses(run.estimated_states()[index])
            np.testing.assert_allclose(ways["map", "odom"] @ odometry, estimate, atol=1e-9)


def test_particles_are_a_pose_array(tmp_path: Path) -> None:
    run = sample_run()
    clouds = exported(tmp_path, run)["/particlecloud"]
    assert len(clouds) == 6
    poses = np.stack([pose_of(pose) for pose in clouds[3].decoded_message.poses])
    np.testing.assert_allclose(poses, run.space.poses(run.frames[3].particles), atol=1e-12)


def test_without_odometry_the_robot_stands_in_the_map(tmp_path: Path) -> None:
    found = exported(tmp_path, sample_run(odometry=None))
    assert "/odom" not in found
    frames = {
        (t.header.frame_id, t.child_frame_id)
        for message in found["/tf"]
        for t in message.decoded_message.transforms
    }
    assert frames == {("map", "base_link")}
    assert len(found["/tf"]) == 5


def test_six_degrees_of_freedom_have_a_full_covariance(tmp_path: Path) -> None:
    run = spatial_run(4)
    found = exported(tmp_path, run)
    covariance = np.reshape(found["/amcl_pose"][1].decoded_message.pose.covariance, (6, 6))
    np.testing.assert_array_equal(covariance, run.frames[1].refined_covariance)
    mode = exported(tmp_path, run, "mode")["/amcl_pose"][1].decoded_message.pose.covariance
    np.testing.assert_array_equal(np.reshape(mode, (6, 6)), run.frames[1].covariance)


@pytest.mark.parametrize(
    "camera",
    [
        Camera("OPENCV", 64, 48, (60.0, 61.0, 31.5, 23.5, 0.1, -0.01, 0.001, 0.002)),
        Camera("FULL_OPENCV", 64, 48, (60.0, 61.0, 31.5, 23.5, *[0.01 * k for k in range(8)])),
        Camera("OPENCV_FISHEYE", 64, 48, (60.0, 61.0, 31.5, 23.5, 0.1, -0.01, 0.001, 0.002)),
    ],
)
def test_the_import_brings_images_camera_and_odometry_back(tmp_path: Path, camera: Camera) -> None:
    noise = np.random.default_rng(2).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    images = tuple(encode_jpeg(noise + k) if k % 2 else encode_png(noise + k) for k in range(6))
    run = sample_run(camera=camera, encoded_images=images)
    exported(tmp_path, run)
    succeed("import", tmp_path / "run.mcap", "-o", tmp_path / "data")
    dataset = load_dataset(tmp_path / "data")
    assert [dataset.read_image_bytes(index) for index in range(6)] == list(images)
    assert dataset.camera == camera
    np.testing.assert_allclose(dataset.body_from_camera, run.base_from_camera, atol=1e-9)
    np.testing.assert_allclose(dataset.timestamps, TIMES, atol=1e-6)
    assert run.odometry is not None
    assert dataset.odometry is not None
    differences = inverse(run.space.poses(run.odometry)) @ dataset.odometry.poses
    np.testing.assert_allclose(differences, np.tile(np.eye(4), (6, 1, 1)), atol=1e-7)


def test_the_command(tmp_path: Path) -> None:
    save_run(tmp_path / "run.h5", sample_run())
    arguments = ("export", tmp_path / "run.h5", "--format", "mcap", "-o", tmp_path / "a.mcap")
    out = succeed(*arguments)
    assert "/amcl_pose" in out
    assert "5 messages" in out
    first = (tmp_path / "a.mcap").read_bytes()
    assert lfnav(*arguments).code == 1
    succeed(*arguments, "--overwrite", "--json")
    assert (tmp_path / "a.mcap").read_bytes() == first
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "run.h5"]


def test_what_cannot_be_exported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "run.mcap"
    save_run(tmp_path / "run.h5", sample_run())
    with pytest.raises(OptionError, match="no estimate 'refined'"):
        export_run_to_bag(tmp_path / "run.h5", target, "refined", overwrite=False)
    with pytest.raises(InputError):
        export_run_to_bag(tmp_path / "gone.h5", target, None, overwrite=False)
    early = run_along(curved_path(3), timestamps=np.array([-1.0, 0.0, 1.0]))
    save_run(tmp_path / "early.h5", early)
    with pytest.raises(StageError, match="none that ROS can state"):
        export_run_to_bag(tmp_path / "early.h5", target, None, overwrite=False)
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    with pytest.raises(StageError, match=r"pip install 'lfnav\[ros\]'"):
        export_run_to_bag(tmp_path / "run.h5", target, None, overwrite=False)
    assert not target.exists()
