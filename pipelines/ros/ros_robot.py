"""``ros2:``, a robot for docking over ROS 2: images, odometry and velocities by topic."""

import atexit
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import InputError, StageError
from pipelines.dataset.camera_file import read_camera_file
from pipelines.geometry.camera import Camera
from pipelines.ros.camera_info import camera_of_info, is_rectified
from pipelines.ros.image_message import image_of_message, message_size
from pipelines.ros.installation import message_type, require_rclpy, required_type
from pipelines.ros.live_localizer import MountedCamera
from pipelines.ros.localization_loop import pose_of_message
from pipelines.ros.pose_track import frame_name, stamp_of
from pipelines.ros.robot_driver import DrivenRobot
from pipelines.ros.robot_settings import robot_settings_of
from pipelines.ros.transform_buffer import TransformBuffer, TransformError
from pipelines.ros.velocity_control import Velocity

NODE = "lfnav_dock"


class RosRobot:
    """A robot whose driver is reached over ROS 2.

    Args:
        path: settings; None: the defaults.

    Raises:
        InputError: the settings cannot be read, or the camera is none that lfnav knows.
        StageError: no ROS 2 here, or the robot is not there: the text says what is missing.
    """

    def __init__(self, path: Path | None = None) -> None:
        settings = robot_settings_of(path)
        rclpy: Any = require_rclpy()
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rclpy.signals import SignalHandlerOptions

        # Ctrl-C is for docking, which stops the robot and saves the run.
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._settings = settings
        self._rclpy, self._node = rclpy, rclpy.create_node(NODE)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._driver: DrivenRobot | None = None
        self._transforms = TransformBuffer()
        self._image: Any = None
        self._info: Any = None
        self._has_odometry = False
        kind = "TwistStamped" if settings.stamped else "Twist"
        self._twist = required_type("geometry_msgs", kind)
        self._velocities = self._node.create_publisher(self._twist, settings.cmd_vel_topic, 10)
        sensor = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        is_compressed = settings.image_topic.endswith("/compressed")
        image = required_type("sensor_msgs", "CompressedImage" if is_compressed else "Image")
        listen = self._node.create_subscription
        listen(image, settings.image_topic, self._on_image, sensor)
        odometry = required_type("nav_msgs", "Odometry")
        listen(odometry, settings.odometry_topic, self._on_odometry, sensor)
        if settings.camera is None:
            self._listen_for_camera()
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        try:
            self._driver = DrivenRobot(self._mounted(), settings, self._send)
            self._wait("odometry", settings.odometry_topic, lambda: self._has_odometry)
            wanted = self._velocities.get_subscription_count
            self._wait("subscription", settings.cmd_vel_topic, lambda: wanted() > 0)
        except BaseException:
            self.close()
            raise

    @property
    def note(self) -> str:
        """One line for the summary."""
        return f"ROS 2, {self._settings.image_topic}, {self._settings.cmd_vel_topic}"

    @property
    def camera(self) -> Camera:
        """Model and intrinsics of the camera."""
        return self._driven.camera

    @property
    def base_from_camera(self) -> FloatArray:
        """``(4, 4)`` the camera's mount."""
        return self._driven.base_from_camera

    def take_image(self) -> ImageArray:
        """An image taken while the robot stands, ``(height, width, 3)`` RGB."""
        return self._driven.take_image()

    def move(self, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Moves, metres and radians, and comes to a stop; returns what odometry measured."""
        return self._driven.move(forward, left, turn)

    def stop(self) -> None:
        """Stops at once."""
        self._driven.stop()

    def close(self) -> None:
        """Stops the robot and leaves the network; done at the program's end, too."""
        atexit.unregister(self.close)
        if not self._rclpy.ok():
            return
        if self._driver is not None:
            self._driver.close()
            # The last message has to leave this process.
            time.sleep(0.1)
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(2.0)
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    @property
    def _driven(self) -> DrivenRobot:
        if self._driver is None:
            raise StageError("the robot is not connected")
        return self._driver

    def _listen_for_camera(self) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        settings, listen = self._settings, self._node.create_subscription
        transforms = message_type("tf2_msgs", "TFMessage")
        if transforms is None:
            raise StageError("there is no tf2_msgs, so that tf cannot be read: give camera")
        sensor = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        kept = QoSProfile(
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL,
        )
        info = required_type("sensor_msgs", "CameraInfo")
        listen(info, settings.info_topic, self._on_info, sensor)
        listen(transforms, "/tf_static", partial(self._on_transforms, is_static=True), kept)
        listen(transforms, "/tf", partial(self._on_transforms, is_static=False), 100)

    def _mounted(self) -> MountedCamera:
        settings = self._settings
        if settings.camera is not None:
            content = read_camera_file(Path(settings.camera))
            if content.base_from_camera is None:
                raise InputError(settings.camera, "has no [mount]")
            return MountedCamera(content.camera, content.base_from_camera)
        self._wait("image", settings.image_topic, lambda: self._image is not None)
        self._wait("CameraInfo", settings.info_topic, lambda: self._info is not None)
        size = message_size(self._image, settings.image_topic)
        camera = camera_of_info(
            self._info,
            size,
            settings.info_topic,
            rectified=is_rectified(settings.image_topic),
        )
        frame = frame_name(self._image.header.frame_id)
        try:
            mount = self._transforms.wait(
                settings.base_frame_id, frame, stamp_of(self._image), settings.start_timeout
            )
        except TransformError as error:
            raise StageError(f"the camera's mount is not known: {error}") from error
        return MountedCamera(camera, mount)

    def _wait(self, what: str, topic: str, condition: Callable[[], bool]) -> None:
        seconds = self._settings.start_timeout
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise StageError(f"no {what} on {topic} within {seconds:g} s: is the robot there?")
            time.sleep(0.02)

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException, ShutdownException

        try:
            self._executor.spin()
        except (ExternalShutdownException, ShutdownException):
            # The program ends.
            return

    def _on_image(self, message: Any) -> None:
        self._image = message
        if self._driver is not None:
            decoded = partial(image_of_message, message, self._settings.image_topic)
            self._driver.saw(decoded, stamp_of(message))

    def _on_info(self, message: Any) -> None:
        self._info = message

    def _on_transforms(self, message: Any, *, is_static: bool) -> None:
        self._transforms.add(message.transforms, is_static=is_static)

    def _on_odometry(self, message: Any) -> None:
        if self._driver is None:
            return
        try:
            pose = pose_of_message(message.pose.pose)
        except TransformError:
            # As if nothing had come: the robot stops after a while.
            return
        self._driver.moved(pose, stamp_of(message))
        self._has_odometry = True

    def _send(self, velocity: Velocity) -> None:
        message = self._twist()
        twist = message
        if self._settings.stamped:
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = self._settings.base_frame_id
            twist = message.twist
        twist.linear.x, twist.linear.y = velocity.forward, velocity.left
        twist.angular.z = velocity.turn
        if self._rclpy.ok():
            self._velocities.publish(message)
