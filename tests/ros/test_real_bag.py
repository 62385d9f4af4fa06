"""A real bag of a TurtleBot with nav2, beside what an independent reader finds in it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.stages import no_progress
from pipelines.geometry.pose import inverse, pose_from_quaternion, rotation_angle
from pipelines.ros.bag_description import describe_bag
from pipelines.ros.bag_file import open_bag
from pipelines.ros.bag_survey import survey_bag
from tests.chain_samples import lfnav

BAG = Path(__file__).parents[3] / "shared" / "data" / "bags" / "nav2_turtlebot.mcap"
CAMERA = "oakd_rgb_camera_optical_frame"
pytestmark = pytest.mark.skipif(not BAG.is_file(), reason="the shared bag is not there")


def read_independently(topic: str) -> list[Any]:
    with BAG.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [found.decoded_message for found in reader.iter_decoded_messages([topic])]


def pose_of(place: Any, turn: Any) -> FloatArray:
    return pose_from_quaternion((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))


def nanoseconds(message: Any) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def test_it_holds_no_images(tmp_path: Path) -> None:
    outcome = lfnav("import", BAG, "-o", tmp_path / "out")
    assert outcome.code == 1
    assert outcome.err == f"lfnav: {BAG}: holds no images\n"
    assert not list(tmp_path.iterdir())


def test_the_mount_is_the_product_of_its_static_transforms() -> None:
    description = describe_bag(BAG, no_progress)
    assert description.base == "base_link"
    parents = {
        transform.child_frame_id: transform
        for message in read_independently("/tf_static")
        for transform in message.transforms
    }
    expected, frame = np.eye(4), CAMERA
    while frame != "base_link":
        link = parents[frame]
        expected = pose_of(link.transform.translation, link.transform.rotation) @ expected
        frame = link.header.frame_id
    np.testing.assert_allclose(description.mounts[CAMERA], expected, atol=1e-9)
    # It looks forwards, from a tower on the robot.
    np.testing.assert_allclose(expected[:3, 2], [1.0, 0.0, 0.0], atol=1e-6)
    assert 0.1 < expected[2, 3] < 0.5


def test_odometry_is_what_the_topic_says_and_agrees_with_tf() -> None:
    with open_bag(BAG) as bag:
        survey = survey_bag(bag, ["/odom"], no_progress)
    track = survey.track("/odom")
    messages = read_independently("/odom")
    assert track.stamps.tolist() == [nanoseconds(message) for message in messages]
    expected = [
        pose_of(message.pose.pose.position, message.pose.pose.orientation) for message in messages
    ]
    np.testing.assert_allclose(track.poses, np.stack(expected), atol=1e-12)
    by_tf = survey.tree.track("odom", "base_link", 0.2)
    poses, known = by_tf.at(track.stamps, 0.2)
    assert np.all(known)
    differences = inverse(poses) @ track.poses
    assert np.linalg.norm(differences[:, :3, 3], axis=1).max() < 1e-4
    assert rotation_angle(differences).max() < np.radians(0.01)


def test_the_camera_in_the_map_is_what_the_transforms_say_one_after_the_other() -> None:
    with open_bag(BAG) as bag:
        tree = survey_bag(bag, [], no_progress).tree
    track = tree.track("map", CAMERA, 0.5)
    mount = tree.fixed("base_link", CAMERA)
    odometry, known = tree.track("odom", "base_link", 0.5).at(track.stamps, 0.5)
    in_map, also = tree.track("map", "odom", 0.5).at(track.stamps, 0.5)
    assert np.all(known & also)
    assert len(track) > 1000
    np.testing.assert_allclose(track.poses, in_map @ odometry @ mount, atol=1e-9)
