"""The stage ``import`` for bags: a recording of ROS in, a data set out.

The bag is read twice: first what is small, then the images, one after the other. Images that were
recorded as JPEG or PNG are kept to the byte. The folder appears whole or not at all.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipelines.artifacts.atomic import atomic_folder, check_output
from pipelines.artifacts.errors import InputError, quoted, reason_of
from pipelines.artifacts.provenance import provenance, sha256_of_bytes
from pipelines.artifacts.stages import Progress
from pipelines.dataset.dataset import GROUNDTRUTH_FILE, ODOMETRY_FILE
from pipelines.dataset.importers.placing import write_lists
from pipelines.dataset.importers.recording import IMAGE_FOLDER, Recording, SourceFrame
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.pose import mount_of
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.reconstruct.import_stage import RECORD_NAME, write_import_record
from pipelines.ros.bag_file import Bag, open_bag
from pipelines.ros.bag_plan import BagPlan, plan_import
from pipelines.ros.image_message import stored_image
from pipelines.ros.pose_track import NANOSECONDS, path_length

KIND = "bag"


@dataclass(frozen=True)
class BagImportSummary:
    """The ``Summary`` of an import.

    Attributes:
        output: the data set.
        bag_format: what the bag is, for people.
        plan: what was taken of it.
    """

    output: Path
    bag_format: str
    plan: BagPlan

    def next_command(self) -> str:
        """The command line that goes on from here."""
        return f"lfnav reconstruct {shlex.quote(str(self.output))} -o map --method sfm"

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        plan, camera = self.plan, self.plan.camera
        chosen = plan.camera_topic
        size = f"{camera.model} {camera.width}x{camera.height}, {camera.intrinsics.fx:.1f} px"
        rows: list[tuple[str, ...]] = [
            ("data set", str(self.output)),
            ("source taken for", f"bag ({self.bag_format})"),
            ("images", f"{len(plan.stamps)} of {chosen.count} of {reason_of(chosen.topic)}"),
            ("camera", f"{size}, frame {reason_of(chosen.frame)}"),
            ("mount", self._mount_text()),
            ("odometry", _poses_text(plan.odometry, plan.odometry_source)),
            ("ground truth", _poses_text(plan.groundtruth, plan.groundtruth_source)),
        ]
        rows += [("note", note) for note in plan.notes]
        rows.append(("next", self.next_command()))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        plan, mount = self.plan, self.plan.base_from_camera
        return {
            "kind": "import",
            "path": str(self.output),
            "source": KIND,
            "format": self.bag_format,
            "images": len(plan.stamps),
            "images_in_bag": plan.camera_topic.count,
            "topic": plan.camera_topic.topic,
            "frame": plan.camera_topic.frame,
            "cameras": [plan.camera.to_dict()],
            "base": plan.base,
            "base_from_camera": None if mount is None else mount.tolist(),
            "odometry": _poses_dict(plan.odometry, plan.odometry_source),
            "groundtruth": _poses_dict(plan.groundtruth, plan.groundtruth_source),
            "notes": list(plan.notes),
            "next_command": self.next_command(),
        }

    def _mount_text(self) -> str:
        plan = self.plan
        if plan.base_from_camera is None:
            return "none: the body is the camera"
        (x, y, z), (roll, pitch, yaw) = mount_of(plan.base_from_camera)
        return (
            f"{x:.3f}, {y:.3f}, {z:.3f} m, roll {roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} "
            f"degrees on {reason_of(plan.base or '')}"
        )


def import_bag(
    source: Path,
    output: Path,
    settings: ImportSettings,
    *,
    overwrite: bool,
    progress: Progress,
) -> BagImportSummary:
    """Makes a data set of a recording of ROS.

    Args:
        source: a file or folder, as for ``open_bag``.
        output: folder to be written, as a whole or not at all.
        settings: the options.
        overwrite: whether an older import there may be replaced.
        progress: told how far the work is.

    Raises:
        InputError: the bag is damaged, holds no images, several cameras and none is named, or not
            what belongs to them; or ``output`` cannot be written.
        OptionError: an option means nothing for a bag, or selects no image.
        StageError: odometry and images are of different times, or ``rosbags`` is missing.
    """
    check_output(output, overwrite, RECORD_NAME)
    settings.check_meant_for(KIND)
    with open_bag(source) as bag:
        plan = plan_import(bag, settings, progress)
        with atomic_folder(output, overwrite, RECORD_NAME) as folder:
            frames, hashes = _write_images(folder, bag, plan, progress)
            recording = Recording(
                frames, (plan.camera,), None, base_from_camera=plan.base_from_camera
            )
            write_lists(folder, recording, None)
            _write_trajectory(folder / ODOMETRY_FILE, plan.odometry)
            _write_trajectory(folder / GROUNDTRUTH_FILE, plan.groundtruth)
            inputs = {"images": sha256_of_bytes("\n".join(hashes).encode())}
            record = provenance("import", settings.to_dict(), inputs)
            write_import_record(folder, KIND, len(frames), plan.notes, record)
        return BagImportSummary(output, bag.format, plan)


def _write_images(
    folder: Path, bag: Bag, plan: BagPlan, progress: Progress
) -> tuple[tuple[SourceFrame, ...], tuple[str, ...]]:
    """The frames in order of time, and the SHA-256 of each."""
    (folder / IMAGE_FOLDER).mkdir()
    topic, size = plan.camera_topic.topic, (plan.camera.width, plan.camera.height)
    place = {int(arrival): index for index, arrival in enumerate(plan.arrivals)}
    written: dict[int, tuple[SourceFrame, str]] = {}
    messages = progress(bag.messages([topic]), "images", bag.count([topic]))
    for arrival, message in enumerate(messages):
        if arrival not in place:
            continue
        index = place[arrival]
        seconds = float(plan.stamps[index] / NANOSECONDS)
        where = f"{bag.path}, topic {quoted(topic)}, image at time {seconds:.6f}"
        image = stored_image(bag.decoded(message), where)
        if (image.header.width, image.header.height) != size:
            raise InputError(
                where,
                f"is {image.header.width}x{image.header.height} pixels, the first one "
                f"{size[0]}x{size[1]}",
                "a data set has one camera and one size",
            )
        name = f"{IMAGE_FOLDER}/{index:06d}{image.suffix}"
        (folder / name).write_bytes(image.data)
        written[index] = (
            SourceFrame(folder / name, name, seconds),
            sha256_of_bytes(image.data),
        )
        if len(written) == len(place):
            break
    if len(written) < len(place):
        raise InputError(bag.path, f"topic {quoted(topic)} has changed while it was read")
    ordered = [written[index] for index in range(len(written))]
    return tuple(frame for frame, _ in ordered), tuple(digest for _, digest in ordered)


def _write_trajectory(path: Path, trajectory: Trajectory | None) -> None:
    if trajectory is not None:
        path.write_text(format_tum(trajectory), encoding="utf-8")


def _poses_text(trajectory: Trajectory | None, source: str | None) -> str:
    if trajectory is None or source is None:
        return "none"
    return f"{reason_of(source)}: {len(trajectory)} poses, {path_length(trajectory.poses):.2f} m"


def _poses_dict(trajectory: Trajectory | None, source: str | None) -> dict[str, Any] | None:
    if trajectory is None:
        return None
    return {
        "source": source,
        "poses": len(trajectory),
        "path_length": path_length(trajectory.poses),
    }
