"""A managed (lifecycle) node around the localization loop: parameters, subscriptions, states.

The only modules that import rclpy are this one and the nodes built on it; they are imported when a
node is run.

Configure reads the parameters and loads the scene, activate begins to take images, deactivate
stops, cleanup gives the scene back. What goes wrong is a line in the log, and the transition fails.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from pipelines.artifacts.errors import InputError, LfnavError, OptionError
from pipelines.artifacts.setting import Entry
from pipelines.artifacts.settings_file import Choices
from pipelines.dataset.camera_file import read_camera_file
from pipelines.lightfield.open_world import OpenWorld, scene_or_world
from pipelines.lightfield.scene import Scene
from pipelines.localize.run import FrameRecord
from pipelines.ros.health import ERROR, Health, Report
from pipelines.ros.installation import message_type, required_type
from pipelines.ros.live_localizer import LiveLocalizer, MountedCamera
from pipelines.ros.localization_loop import LocalizationLoop
from pipelines.ros.node_settings import (
    ENTRIES,
    NodeSettings,
    chosen_by_parameters,
    declared_defaults,
    effective_settings,
    parameter_value,
    setting_of_parameter,
)
from pipelines.ros.pose_publishing import KnownPose
from pipelines.ros.pose_track import NANOSECONDS

SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
STREAM = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
ODOMETRY = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# AMCL's parameters of the first pose.
INITIAL_POSE = ("initial_pose.x", "initial_pose.y", "initial_pose.yaw")


@dataclass(frozen=True)
class NodeRequest:
    """What a node is to localize in.

    Attributes:
        scene: scene model, or the folder of a world.
        config: settings file of the localization; None: there is none.
        chosen: settings by path that win over it; parameters win over them.
        seed: of the filter's random numbers.
        memory: megabytes that a world may take; None: 1000.
        autostart: whether the node configures and activates itself.
    """

    scene: Path
    config: Path | None
    chosen: Choices
    seed: int = 0
    memory: float | None = None
    autostart: bool = False


class ManagedNode(LifecycleNode):  # type: ignore[misc]
    """A node that localizes; what it publishes is said by those built on it.

    Args:
        name: of the node.
        request: what it localizes in.

    Raises:
        InputError, OptionError: impossible settings.
    """

    def __init__(self, name: str, request: NodeRequest) -> None:
        super().__init__(name)
        self._request = request
        self._defaults = declared_defaults(effective_settings(request.config, request.chosen))
        self._entries: dict[str, Entry] = {}
        self._made: list[Any] = []
        self._loop: LocalizationLoop | None = None
        self._settings = NodeSettings()
        self._health = Health(self._settings.camera_silence, self._settings.image_topic)
        self._declare()
        self.add_on_set_parameters_callback(self._check_parameters)
        back = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jump = self.get_clock().create_jump_callback(back, post_callback=self._on_jump)

    # ------------------------------------------------------------------ for the nodes built on it

    def make_interfaces(self) -> None:
        """Publishers and services; what is made with ``own`` is destroyed by cleanup."""

    def own(self, made: Any) -> Any:
        """Remembers a publisher, subscription, service or timer."""
        self._made.append(made)
        return made

    @property
    def state_name(self) -> str:
        """Of the lifecycle: ``unconfigured``, ``inactive``, ``active``, ``finalized``."""
        return str(self._state_machine.current_state[1])

    def end(self) -> None:
        """Stops whatever runs; the node is destroyed next."""
        self._give_back()

    def declare_setting(self, entry: Entry, value: Any) -> None:
        """Declares a setting as a parameter, which is checked when it is set."""
        descriptor = rclpy.node.ParameterDescriptor(description=entry.comment, dynamic_typing=True)
        self._entries[entry.name] = entry
        self.declare_parameter(entry.name, value, descriptor)

    @property
    def settings(self) -> NodeSettings:
        """As configured."""
        return self._settings

    @property
    def loop(self) -> LocalizationLoop:
        """As configured.

        Raises:
            OptionError: it is not.
        """
        if self._loop is None:
            raise OptionError("the node is not configured")
        return self._loop

    # ------------------------------------------------------------------ outputs of the loop

    def pose(self, pose: KnownPose) -> None:
        """The pose of a new image."""

    def transform(self, map_from_odom: Any, stamp: int) -> None:
        """The transform at the moment of an image."""

    def frame(self, record: FrameRecord, stamp: int) -> None:
        """The belief after an image."""

    def say(self, text: str, *, is_error: bool) -> None:
        """A line in the log."""
        if is_error:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)

    # ------------------------------------------------------------------ states

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reads the parameters, loads the scene, makes topics and services."""
        try:
            self._configure()
        except LfnavError as error:
            self.say(str(error), is_error=True)
            self._give_back()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begins to localize."""
        self.loop.start()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops to localize; the pose is remembered."""
        self.loop.stop()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Gives scene, topics and services back."""
        self._give_back()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ends whatever runs."""
        self._give_back()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a defect: as before configure."""
        self._give_back()
        return TransitionCallbackReturn.SUCCESS

    def _configure(self) -> None:
        values = {name: self.get_parameter(name).value for name in self._entries}
        chosen = {**self._request.chosen, **chosen_by_parameters(self._defaults, values)}
        if self.get_parameter("set_initial_pose").value and "start" not in chosen:
            chosen["start"] = tuple(float(self.get_parameter(name).value) for name in INITIAL_POSE)
        self._settings, settings = effective_settings(self._request.config, chosen)
        scene = scene_or_world(self._request.scene, self._request.memory)
        mounted = None
        if self._settings.camera_file is not None:
            mounted = mounted_camera(self._settings.camera_file)
        localizer = LiveLocalizer(scene, settings, self._request.seed, mounted)
        self._health = Health(self._settings.camera_silence, self._settings.image_topic)
        self._loop = LocalizationLoop(localizer, self._settings, self, self._health)
        self.make_interfaces()
        self._subscribe()
        self.say(f"localizes in {scene_text(scene)}", is_error=False)

    def _subscribe(self) -> None:
        settings, loop = self._settings, self.loop
        kind = "CompressedImage" if settings.is_compressed else "Image"
        image = required_type("sensor_msgs", kind)
        self._listen(image, settings.image_topic, self._on_image, SENSOR)
        if settings.camera_file is None:
            info = required_type("sensor_msgs", "CameraInfo")
            self._listen(info, settings.info_topic, loop.on_camera_info, SENSOR)
        if settings.odometry_topic:
            odometry = required_type("nav_msgs", "Odometry")
            self._listen(odometry, settings.odometry_topic, loop.on_odometry, ODOMETRY)
        transforms = message_type("tf2_msgs", "TFMessage")
        if transforms is not None:
            self._listen(
                transforms, "/tf", lambda m: loop.on_transforms(m, is_static=False), STREAM
            )
            self._listen(
                transforms, "/tf_static", lambda m: loop.on_transforms(m, is_static=True), KEPT
            )
        elif not settings.odometry_topic or settings.camera_file is None:
            raise OptionError(
                "there is no tf2_msgs, so that tf cannot be read: give odometry_topic and camera"
            )
        # By a clock of its own: a simulated one may stand still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.own(self.create_timer(0.5, self._check, clock=steady))
        diagnostics = message_type("diagnostic_msgs", "DiagnosticArray")
        if diagnostics is None:
            self.say("there is no diagnostic_msgs: nothing is said on /diagnostics", is_error=False)
            return
        publisher = self.own(self.create_publisher(diagnostics, "/diagnostics", 10))
        self.own(
            self.create_timer(
                1.0, lambda: publisher.publish(self._diagnostics(diagnostics)), clock=steady
            )
        )

    def _listen(self, kind: Any, topic: str, callback: Any, qos: QoSProfile) -> None:
        self.own(self.create_subscription(kind, topic, callback, qos))

    def _on_image(self, message: Any) -> None:
        if self._is_active:
            self.loop.on_image(message)

    @property
    def _is_active(self) -> bool:
        return self.state_name == "active"

    def _check(self) -> None:
        if self._is_active:
            self.loop.check()

    def _on_jump(self, jump: Any) -> None:
        if self._loop is not None:
            self._loop.clock_was_set_back()

    def _give_back(self) -> None:
        if self._loop is not None:
            self._loop.stop()
            self._loop = None
        destroy = (
            self.destroy_publisher,
            self.destroy_subscription,
            self.destroy_service,
            self.destroy_timer,
        )
        for made in self._made:
            any(one(made) for one in destroy)
        self._made = []

    # ------------------------------------------------------------------ parameters, diagnostics

    def _declare(self) -> None:
        described = rclpy.node.ParameterDescriptor
        for entry in ENTRIES:
            self.declare_setting(entry, parameter_value(entry, self._defaults[entry.path]))
        text = described(description="whether the first pose is that of initial_pose")
        self.declare_parameter("set_initial_pose", value=False, descriptor=text)
        for name in INITIAL_POSE:
            text = described(description="of the first pose", dynamic_typing=True)
            self.declare_parameter(name, 0.0, text)

    def _check_parameters(self, parameters: list[Parameter]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        try:
            for parameter in parameters:
                if parameter.name in self._entries:
                    setting_of_parameter(self._entries[parameter.name], parameter.value)
        except LfnavError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True, reason="taken by the next configure")

    def _diagnostics(self, kind: Any) -> Any:
        from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

        report = self._health.report(time.monotonic())
        if not self._is_active:
            report = Report(0, "inactive", report.values)
        level = bytes([min(report.level, ERROR)])
        values = [KeyValue(key=key, value=value) for key, value in report.values.items()]
        status = DiagnosticStatus(
            level=level,
            name=f"{self.get_name()}: localization",
            message=report.message,
            hardware_id=self._settings.image_topic,
            values=values,
        )
        message = kind(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        return message


def time_message(stamp: int) -> Any:
    """A builtin_interfaces/Time of nanoseconds."""
    from builtin_interfaces.msg import Time

    return Time(sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS)


def mounted_camera(path: Path) -> MountedCamera:
    """Camera and mount of a ``camera.toml``.

    Raises:
        InputError: unreadable, or without mount.
    """
    content = read_camera_file(path)
    if content.base_from_camera is None:
        raise InputError(path, "has no [mount], which says where the camera sits on the robot")
    return MountedCamera(content.camera, content.base_from_camera)


def scene_text(scene: Scene | OpenWorld) -> str:
    """What is localized in, for the log."""
    x_min, x_max, y_min, y_max = scene.bounds
    count = len(scene.world_from_camera)
    return (
        f"{count} views, x {x_min:.2f} to {x_max:.2f} m, y {y_min:.2f} to {y_max:.2f} m in the map"
    )
