"""A second process that is a node of lfnav, and a node of this process that plays the robot.

Everything stays on this machine's loopback, in a domain of its own.
"""

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import Dataset
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import quaternion_of

rclpy = pytest.importorskip("rclpy", reason="no rclpy: make test-ros makes an environment with it")

PATIENCE = 60.0
# Of the 101 domains that any machine can use; several suites may run on one.
DOMAIN = str(1 + os.getpid() % 100)
LOOPBACK = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": DOMAIN}


@contextmanager
def node_process(log: Path, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """``lfnav ros ...`` in a process of its own, ended by Ctrl-C."""
    command = [sys.executable, "-m", "lfnav_cli.main", "ros", *arguments]
    with log.open("wb") as file:
        process = subprocess.Popen(
            command, stdout=file, stderr=file, env={**os.environ, **LOOPBACK}
        )
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
    assert process.returncode == 0, log.read_text()


class RobotNode:
    """Plays the robot: publishes images, camera, tf; keeps what it hears of the localizer."""

    def __init__(self) -> None:
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import CameraInfo, CompressedImage
        from tf2_msgs.msg import TFMessage

        os.environ.update(LOOPBACK)
        rclpy.init(args=[])
        self.node = rclpy.create_node("robot")
        latched = QoSProfile(
            depth=1,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        make = self.node.create_publisher
        self.images = make(CompressedImage, "camera/image_raw/compressed", 10)
        self.infos = make(CameraInfo, "camera/camera_info", 10)
        self.tf = make(TFMessage, "/tf", 100)
        self.tf_static = make(TFMessage, "/tf_static", latched)
        self.initial_pose = make(PoseWithCovarianceStamped, "initialpose", 10)
        self.camera_frame = "camera_optical"
        self.poses: list[Any] = []
        self.transforms: list[Any] = []
        listen = self.node.create_subscription
        listen(PoseWithCovarianceStamped, "amcl_pose", self.poses.append, latched)
        listen(TFMessage, "/tf", self._on_transforms, 100)

    def close(self) -> None:
        """Leaves the network."""
        self.node.destroy_node()
        rclpy.try_shutdown()

    def until(self, condition: Callable[[], Any], what: str, seconds: float = PATIENCE) -> None:
        """Waits for something while messages are received."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"no {what} within {seconds} s"
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Receives messages for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def change_state(self, name: str, step: str) -> bool:
        """Asks for a transition like ``configure``; whether it succeeded."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        numbers = {
            "configure": Transition.TRANSITION_CONFIGURE,
            "activate": Transition.TRANSITION_ACTIVATE,
            "deactivate": Transition.TRANSITION_DEACTIVATE,
            "cleanup": Transition.TRANSITION_CLEANUP,
        }
        request = ChangeState.Request()
        request.transition.id = numbers[step]
        return bool(self.call(ChangeState, f"{name}/change_state", request).success)

    def state(self, name: str) -> str:
        """The state of a managed node."""
        from lifecycle_msgs.srv import GetState

        answer = self.call(GetState, f"{name}/get_state", GetState.Request())
        return str(answer.current_state.label)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """The answer of a service."""
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, f"service {service}")
        future = client.call_async(request)
        self.until(future.done, f"answer of {service}")
        self.node.destroy_client(client)
        return future.result()

    def set_parameter(self, name: str, parameter: str, value: Any) -> tuple[bool, str]:
        """Sets a parameter of another node; whether it was taken, and why not."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request()
        request.parameters = [Parameter(parameter, value=value).to_parameter_msg()]
        (result,) = self.call(SetParameters, f"{name}/set_parameters", request).results
        return bool(result.successful), str(result.reason)

    def publish_mount(self, dataset: Dataset) -> None:
        """Publishes where the camera sits on the robot."""
        assert dataset.base_from_camera is not None
        self.publish_transform("base_link", self.camera_frame, 0, dataset.base_from_camera)

    def camera_info(self, camera: Camera) -> Any:
        """A CameraInfo."""
        from sensor_msgs.msg import CameraInfo

        fx, fy, cx, cy, *distortion = camera.params
        info = CameraInfo(width=camera.width, height=camera.height, distortion_model="plumb_bob")
        info.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
        info.d = [*distortion, 0.0]
        info.header.frame_id = self.camera_frame
        return info

    def publish_transform(self, parent: str, child: str, stamp: int, pose: FloatArray) -> None:
        """A transform; of stamp 0 a static one."""
        from geometry_msgs.msg import TransformStamped
        from tf2_msgs.msg import TFMessage

        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = parent
        message.header.stamp = time_message(stamp)
        place, turn = message.transform.translation, message.transform.rotation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turn.x, turn.y, turn.z, turn.w = quaternion_of(pose).tolist()
        publisher = self.tf if stamp else self.tf_static
        publisher.publish(TFMessage(transforms=[message]))

    def publish_image(self, data: bytes, camera: Camera, stamp: int, form: str = "jpeg") -> None:
        """A JPEG or PNG, and the camera that took it."""
        from sensor_msgs.msg import CompressedImage

        message = CompressedImage(format=form, data=data)
        message.header.stamp = time_message(stamp)
        message.header.frame_id = self.camera_frame
        self.infos.publish(self.camera_info(camera))
        self.images.publish(message)

    def see(self, dataset: Dataset, index: int, stamp: int, *, with_tf: bool = True) -> None:
        """Publishes an image of a data set, and the odometry at its moment."""
        assert dataset.odometry is not None
        assert dataset.camera is not None
        if with_tf:
            self.publish_transform("odom", "base_link", stamp, dataset.odometry.poses[index])
        self.publish_image(dataset.read_image_bytes(index), dataset.camera, stamp)

    def see_until(
        self, dataset: Dataset, index: int, stamp: int, condition: Callable[[], Any], what: str
    ) -> None:
        """Publishes an image until something happens: who has just come misses the first."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"no {what} within {PATIENCE} s"
            self.see(dataset, index, stamp)
            self.spin_until(condition, 1.0)

    def spin_until(self, condition: Callable[[], Any], seconds: float) -> None:
        """Receives messages until something happens, for so long at most."""
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def give_pose(
        self, pose: FloatArray, position: float, heading: float, frame: str = "map"
    ) -> None:
        """Tells the localizer roughly where the robot is."""
        from geometry_msgs.msg import PoseWithCovarianceStamped

        message = PoseWithCovarianceStamped()
        message.header.frame_id = frame
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        place.x, place.y, place.z = pose[:3, 3].tolist()
        turn.x, turn.y, turn.z, turn.w = quaternion_of(pose).tolist()
        covariance = np.diag([position, position, 0.0, 0.0, 0.0, heading]) ** 2
        message.pose.covariance = covariance.reshape(36)
        self.until(self.initial_pose.get_subscription_count, "subscription to initialpose")
        self.initial_pose.publish(message)

    def _on_transforms(self, message: Any) -> None:
        self.transforms += [item for item in message.transforms if item.child_frame_id == "odom"]


def time_message(stamp: int) -> Any:
    """A builtin_interfaces/Time of nanoseconds."""
    from builtin_interfaces.msg import Time

    return Time(sec=stamp // 10**9, nanosec=stamp % 10**9)


def nanoseconds(message: Any) -> int:
    """The time of a message's header."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def planar(pose: Any) -> FloatArray:
    """x, y and heading of a geometry_msgs/Pose."""
    turn = pose.orientation
    heading = math.atan2(
        2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2)
    )
    return np.array([pose.position.x, pose.position.y, heading])
