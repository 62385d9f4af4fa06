"""The node that tells nav2's docking server where the dock is: no markers, no lidar."""

from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from pipelines.artifacts.errors import OptionError
from pipelines.geometry.pose import quaternion_of
from pipelines.ros.detector_settings import ENTRIES, DetectorSettings
from pipelines.ros.dock_detection import base_from_dock, objection
from pipelines.ros.localizer_node import fill_pose
from pipelines.ros.managed_node import ManagedNode, NodeRequest, time_message
from pipelines.ros.node_settings import parameter_value, setting_of_parameter
from pipelines.ros.pose_publishing import KnownPose

NAME = "dock_detector"


class DockDetectorNode(ManagedNode):
    """Publishes ``detected_dock_pose`` between two calls of its trigger.

    Args:
        request: what it localizes in.
        detector: which dock, and when its pose is sure; parameters win.
    """

    def __init__(self, request: NodeRequest, detector: DetectorSettings) -> None:
        self._detector = detector
        self._poses: Any = None
        self._is_detecting = False
        super().__init__(NAME, request)
        for entry in ENTRIES:
            value = parameter_value(entry, entry.value_in(detector))
            self.declare_setting(entry, value)

    def make_interfaces(self) -> None:
        """The topic, and services that start and stop it."""
        self._detector_settings()
        quaternion_of(np.eye(4))
        quality = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._poses = self.own(self.create_publisher(PoseStamped, "detected_dock_pose", quality))
        for name, callback in (
            ("detect_dock", self._on_trigger),
            ("detect_dock/start", self._on_start),
            ("detect_dock/stop", self._on_stop),
        ):
            self.own(self.create_service(Trigger, name, callback))
        self._is_detecting = False

    def pose(self, pose: KnownPose) -> None:
        """The dock, from the robot at the moment of the image."""
        detector = self._detector
        if not self._is_detecting or detector.goal is None:
            return
        text = objection(pose, detector, self.get_clock().now().nanoseconds)
        self.loop.note("dock", f"no dock is detected: {text}" if text else "")
        if text:
            return
        message = PoseStamped()
        message.header.stamp = time_message(pose.stamp)
        message.header.frame_id = self.settings.base_frame_id
        fill_pose(message.pose, base_from_dock(pose, detector.goal))
        self._poses.publish(message)

    def _detector_settings(self) -> DetectorSettings:
        """As the parameters say now: another dock needs no other configuration."""
        values = {
            entry.path: setting_of_parameter(entry, self.get_parameter(entry.name).value)
            for entry in ENTRIES
        }
        self._detector = replace(self._detector, **values)
        return self._detector

    def _on_trigger(self, request: Any, response: Any) -> Any:
        """nav2 asks once to start and once to stop."""
        return self._switch(not self._is_detecting, response)

    def _on_start(self, request: Any, response: Any) -> Any:
        return self._switch(True, response)

    def _on_stop(self, request: Any, response: Any) -> Any:
        return self._switch(False, response)

    def _switch(self, is_on: bool, response: Any) -> Any:
        response.success, response.message = True, "stopped"
        if is_on:
            try:
                goal = self._detector_settings().goal
            except OptionError as error:
                response.success, response.message = False, str(error)
                return response
            if goal is None:
                response.success, response.message = False, "parameter goal is none"
                return response
            if self.state_name != "active":
                response.success, response.message = False, f"the node is {self.state_name}"
                return response
            response.message = f"detecting the dock at x {goal[0]:.3f} m, y {goal[1]:.3f} m"
        self._is_detecting = is_on
        self.say(response.message, is_error=False)
        return response
