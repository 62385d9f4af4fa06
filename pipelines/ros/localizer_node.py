"""The node that stands where AMCL would: its topics, services and transform, from camera images."""

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Empty

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import LfnavError, quoted
from pipelines.geometry.pose import quaternion_of
from pipelines.localize.run import FrameRecord
from pipelines.localize.state_space import state_space_of_dimension
from pipelines.ros.installation import message_type, required_type
from pipelines.ros.localization_loop import covariance_of_message, pose_of_message
from pipelines.ros.managed_node import SENSOR, STREAM, ManagedNode, NodeRequest, time_message
from pipelines.ros.pose_publishing import KnownPose, weighted_particles
from pipelines.ros.pose_track import NANOSECONDS, frame_name

# AMCL's name, by which nav2's lifecycle manager and its parameter files call it.
NAME = "amcl"
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class LocalizerNode(ManagedNode):
    """Publishes ``amcl_pose``, ``/tf`` and ``particle_cloud``; takes ``initialpose``."""

    def __init__(self, request: NodeRequest) -> None:
        super().__init__(NAME, request)
        self._poses: Any = None
        self._transforms: Any = None
        self._clouds: Any = None

    def make_interfaces(self) -> None:
        """Topics and services, named and typed as AMCL's."""
        # SciPy's rotations take 0.2 s to load: not with the first image.
        quaternion_of(np.eye(4))
        self._poses = self.own(
            self.create_publisher(PoseWithCovarianceStamped, "amcl_pose", LATCHED)
        )
        self._transforms = self._publisher_of("tf2_msgs", "TFMessage", "/tf", STREAM)
        self._clouds = self._publisher_of("nav2_msgs", "ParticleCloud", "particle_cloud", SENSOR)
        self.own(
            self.create_subscription(
                PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, 10
            )
        )
        self.own(
            self.create_service(Empty, "reinitialize_global_localization", self._on_reinitialize)
        )
        self.own(self.create_service(Empty, "request_nomotion_update", self._on_update))
        kind = message_type("nav2_msgs", "SetInitialPose", "srv")
        if kind is None:
            self.say(
                "there is no nav2_msgs/srv/SetInitialPose: set_initial_pose is left out",
                is_error=False,
            )
        else:
            self.own(self.create_service(kind, "set_initial_pose", self._on_set_initial_pose))

    def pose(self, pose: KnownPose) -> None:
        """``amcl_pose``, with the stamp of the image."""
        message = PoseWithCovarianceStamped()
        message.header.stamp = time_message(pose.stamp)
        message.header.frame_id = self.settings.global_frame_id
        fill_pose(message.pose.pose, pose.map_from_base)
        message.pose.covariance = pose.covariance.reshape(36)
        self._poses.publish(message)

    def transform(self, map_from_odom: FloatArray, stamp: int) -> None:
        """``/tf`` from the map to odometry's frame, valid for a while beyond the image."""
        settings = self.settings
        if self._transforms is None or not settings.tf_broadcast:
            return
        transform = TransformStamped()
        until = stamp + round(settings.transform_tolerance * NANOSECONDS)
        transform.header.stamp = time_message(until)
        transform.header.frame_id = settings.global_frame_id
        transform.child_frame_id = settings.odom_frame_id
        translation, rotation = transform.transform.translation, transform.transform.rotation
        translation.x, translation.y, translation.z = map_from_odom[:3, 3].tolist()
        rotation.x, rotation.y, rotation.z, rotation.w = quaternion_of(map_from_odom).tolist()
        self._transforms.publish(required_type("tf2_msgs", "TFMessage")(transforms=[transform]))

    def frame(self, record: FrameRecord, stamp: int) -> None:
        """``particle_cloud``: the heaviest particles, where anybody listens."""
        if self._clouds is None or not self._clouds.get_subscription_count():
            return
        space = state_space_of_dimension(record.particles.shape[1])
        poses, weights = weighted_particles(record, space, self.settings.max_particles_published)
        cloud = required_type("nav2_msgs", "ParticleCloud")()
        particle = required_type("nav2_msgs", "Particle")
        cloud.header.stamp = time_message(stamp)
        cloud.header.frame_id = self.settings.global_frame_id
        for place, weight in zip(poses, weights.tolist(), strict=True):
            cloud.particles.append(particle(weight=weight))
            fill_pose(cloud.particles[-1].pose, place)
        self._clouds.publish(cloud)

    def _publisher_of(self, package: str, name: str, topic: str, qos: QoSProfile) -> Any:
        kind = message_type(package, name)
        if kind is None:
            self.say(f"there is no {package}/msg/{name}: topic {topic} is left out", is_error=False)
            return None
        return self.own(self.create_publisher(kind, topic, qos))

    def _on_initial_pose(self, message: Any) -> None:
        frame = frame_name(message.header.frame_id)
        if frame not in ("", self.settings.global_frame_id):
            wanted = quoted(self.settings.global_frame_id)
            text = f"initialpose is in frame {quoted(frame)}, not in {wanted}: ignored"
            self.say(text, is_error=True)
            return
        try:
            pose = pose_of_message(message.pose.pose)
            self.loop.set_pose(pose, covariance_of_message(message.pose.covariance))
        except LfnavError as error:
            self.say(f"initialpose: {error}", is_error=True)

    def _on_set_initial_pose(self, request: Any, response: Any) -> Any:
        self._on_initial_pose(request.pose)
        return response

    def _on_reinitialize(self, request: Any, response: Any) -> Any:
        self.say("searching the whole area", is_error=False)
        self.loop.search()
        return response

    def _on_update(self, request: Any, response: Any) -> Any:
        """Every image updates the filter, whether the robot moves or not."""
        return response


def fill_pose(message: Any, pose: FloatArray) -> None:
    """Writes a pose ``(4, 4)`` into a geometry_msgs/Pose."""
    place, turn = message.position, message.orientation
    place.x, place.y, place.z = pose[:3, 3].tolist()
    turn.x, turn.y, turn.z, turn.w = quaternion_of(pose).tolist()
