"""What there is of ROS 2 on this machine. lfnav itself needs none of it."""

import importlib
from types import ModuleType
from typing import Any

from pipelines.artifacts.errors import StageError, reason_of


def require_rclpy() -> ModuleType:
    """The Python client of ROS 2.

    Raises:
        StageError: there is none.
    """
    try:
        return importlib.import_module("rclpy")
    except ImportError as error:
        raise StageError(
            f"ROS 2 is not found ({reason_of(error)}); source /opt/ros/DISTRIBUTION/setup.bash "
            "and use the Python that it was made for"
        ) from error


def message_type(package: str, name: str, kind: str = "msg") -> Any | None:
    """A message or service of the installation; None where it has none.

    Args:
        package: like ``nav2_msgs``.
        name: like ``ParticleCloud``.
        kind: ``msg`` or ``srv``.
    """
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name, None)
    except ImportError:
        return None


def required_type(package: str, name: str, kind: str = "msg") -> Any:
    """A message or service without which there is nothing to do.

    Raises:
        StageError: the installation has none.
    """
    found = message_type(package, name, kind)
    if found is None:
        raise StageError(
            f"the installation of ROS 2 has no {package}/{kind}/{name}: install "
            f"ros-DISTRIBUTION-{package.replace('_', '-')}"
        )
    return found
