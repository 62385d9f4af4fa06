"""Runs a node until it is stopped."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from pipelines.artifacts.arguments import checked_number
from pipelines.artifacts.errors import InputError, StageError
from pipelines.artifacts.settings_file import Choices
from pipelines.ros import detector_settings
from pipelines.ros.detector_settings import DetectorSettings
from pipelines.ros.installation import require_rclpy
from pipelines.ros.node_settings import effective_settings

if TYPE_CHECKING:
    from pipelines.ros.managed_node import ManagedNode, NodeRequest

# Seconds after which a node looks whether it has been stopped.
LONGEST_WAIT = 0.1


def run_localizer(
    scene: Path,
    config: Path | None,
    chosen: Choices,
    *,
    seed: int = 0,
    memory: float | None = None,
    autostart: bool = False,
    ros_arguments: Sequence[str] = (),
) -> None:
    """Runs the localizer node.

    Args:
        scene: scene model, or the folder of a world.
        config: settings file of the localization; None: there is none.
        chosen: settings by path that win over it.
        seed: of the filter's random numbers.
        memory: megabytes that a world may take; None: 1000.
        autostart: whether the node configures and activates itself.
        ros_arguments: from ``--ros-args`` on.

    Raises:
        InputError, OptionError: impossible settings.
        StageError: there is no ROS 2, or the node could not start itself.
    """
    _check(scene, config, chosen, seed)
    from pipelines.ros.localizer_node import LocalizerNode
    from pipelines.ros.managed_node import NodeRequest

    request = NodeRequest(scene, config, chosen, seed, memory, autostart)
    _run(LocalizerNode, request, ros_arguments)


def run_dock_detector(
    scene: Path,
    config: Path | None,
    chosen: Choices,
    *,
    seed: int = 0,
    memory: float | None = None,
    autostart: bool = False,
    ros_arguments: Sequence[str] = (),
) -> None:
    """Runs the node that detects a dock for nav2.

    Args:
        scene: scene model, or the folder of a world.
        config: settings file of the localization; None: there is none.
        chosen: settings by path that win over it, those of the detector among them.
        seed: of the filter's random numbers.
        memory: megabytes that a world may take; None: 1000.
        autostart: whether the node configures and activates itself.
        ros_arguments: from ``--ros-args`` on.

    Raises:
        InputError, OptionError: impossible settings.
        StageError: there is no ROS 2, or the node could not start itself.
    """
    own = {entry.path for entry in detector_settings.ENTRIES}
    detector = DetectorSettings(**{name: value for name, value in chosen.items() if name in own})
    chosen = {name: value for name, value in chosen.items() if name not in own}
    _check(scene, config, chosen, seed)
    from pipelines.ros.dock_detector_node import DockDetectorNode
    from pipelines.ros.managed_node import NodeRequest

    request = NodeRequest(scene, config, chosen, seed, memory, autostart)
    _run(lambda given: DockDetectorNode(given, detector), request, ros_arguments)


def _check(scene: Path, config: Path | None, chosen: Choices, seed: int) -> None:
    """What can be refused before anything of ROS is loaded."""
    if not scene.exists():
        raise InputError(scene, "does not exist")
    checked_number(seed, "seed", 0, whole=True)
    effective_settings(config, chosen)
    require_rclpy()


def _run(
    make: "Callable[[NodeRequest], ManagedNode]",
    request: "NodeRequest",
    ros_arguments: Sequence[str],
) -> None:
    rclpy: Any = require_rclpy()
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    with _stop_signals() as stopped:
        rclpy.init(args=list(ros_arguments), signal_handler_options=SignalHandlerOptions.NO)
        node = None
        try:
            executor = SingleThreadedExecutor()
            node = make(request)
            if request.autostart:
                _start(node)
            executor.add_node(node)
            while not stopped.is_set():
                executor.spin_once(timeout_sec=LONGEST_WAIT)
        except (KeyboardInterrupt, ExternalShutdownException):
            # A second Ctrl-C, or the end of the context.
            pass
        finally:
            if node is not None:
                node.end()
                node.destroy_node()
            rclpy.try_shutdown()


@contextmanager
def _stop_signals() -> Iterator[threading.Event]:
    """Ctrl-C and SIGTERM, how a node usually ends, only set an event; a second Ctrl-C interrupts.

    An exception may come while rclpy converts an argument, which then fails with another one.
    """
    stopped = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        # Only there signals can be taken; who runs a node elsewhere stops it by its context.
        yield stopped
        return

    def stop(number: int, frame: FrameType | None) -> None:
        if stopped.is_set() and number == signal.SIGINT:
            signal.default_int_handler(number, frame)
        stopped.set()

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _start(node: "ManagedNode") -> None:
    for step, wanted in ((node.trigger_configure, "inactive"), (node.trigger_activate, "active")):
        step()
        if node.state_name != wanted:
            raise StageError("the node could not start; the log says why")
