"""Files of poses as programs write them: orders, units, separators, gaps."""

import logging
from pathlib import Path

import numpy as np
import pytest
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.geometry.pose import pose_from_quaternion, quaternion_of, world_from_base_planar
from pipelines.geometry.pose_columns import columns_named_by
from pipelines.geometry.trajectory import Trajectory, format_tum, read_tum

TIMES = np.array([1403636579.5, 1403636579.75, 1403636580.0, 1403636580.25])
POSES = world_from_base_planar(
    np.array([[0.0, 0.0, 0.1], [0.2, 0.1, 0.5], [0.3, 0.3, 1.0], [0.3, 0.6, 1.5]])
)
EUROC = "#timestamp{unit}, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], " + (
    "q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]"
)
ROS = "%time,field.header.seq,field.header.stamp," + ",".join(
    [f"field.pose.pose.position.{axis}" for axis in "xyz"]
    + [f"field.pose.pose.orientation.{axis}" for axis in "xyzw"]
    + [f"field.twist.twist.linear.{axis}" for axis in "xyz"]
)


@pytest.fixture(autouse=True)
def _warnings_are_said(caplog: pytest.LogCaptureFixture) -> None:
    # Commands with --quiet, which other tests run, silence the library.
    caplog.set_level(logging.WARNING, logger="pipelines")


def rows(order: str, unit: float = 1.0, metre: float = 1.0) -> list[list[str]]:
    """The poses as cells: ``t`` the time, ``p`` the position, ``wxyz`` the quaternion, ``0``."""
    table = []
    for time, pose, turned in zip(TIMES, POSES, quaternion_of(POSES), strict=True):
        values = dict(zip("xyzw", turned.tolist(), strict=True))
        cells = {key: [f"{value:.9f}"] for key, value in values.items()}
        cells["t"] = [f"{round(time * unit)}" if unit > 1.0 else f"{time:.6f}"]
        cells["p"] = [f"{metre * value:.9f}" for value in pose[:3, 3]]
        cells["0"] = ["0.5"]
        table.append([cell for key in order for cell in cells[key]])
    return table


def check(path: Path, times: FloatArray = TIMES, poses: FloatArray = POSES) -> None:
    found = read_tum(path)
    np.testing.assert_allclose(found.timestamps, times, atol=1e-6)
    np.testing.assert_allclose(found.poses, poses, atol=1e-7)


@pytest.mark.parametrize(
    ("header", "order", "separator", "unit", "metre"),
    [
        (EUROC.format(unit=" [ns]"), "tpwxyz000", ",", 1e9, 1.0),
        (EUROC.format(unit=""), "tpwxyz000", ", ", 1e9, 1.0),
        (
            "#t [ns] p_x [m] p_y [m] p_z [m] q_w [] q_x [] q_y [] q_z []",
            "tpwxyz",
            " ",
            1e9,
            1,
        ),
        (ROS, "t0tpxyzw000", ",", 1e9, 1.0),
        ("time,x,y,z,qw,qx,qy,qz", "tpwxyz", ",", 1.0, 1.0),
        ("# timestamp qx qy qz qw tx ty tz", "txyzwp", " ", 1.0, 1.0),
        (
            "Time (us)\tPosX [mm]\tPosY\tPosZ\tQuatX\tQuatY\tQuatZ\tQuatW",
            "tpxyzw",
            "\t",
            1e6,
            1e3,
        ),
        ("# timestamp tx ty tz qx qy qz qw", "tpxyzw", ";", 1.0, 1.0),
        ("# recorded on a rainy day", "tpxyzw", "\t", 1.0, 1.0),
    ],
)
def test_the_header_says_which_column_is_which(
    tmp_path: Path, header: str, order: str, separator: str, unit: float, metre: float
) -> None:
    path = tmp_path / "poses"
    lines = [header, *(separator.join(row) for row in rows(order, unit, metre))]
    for end, encoding in (("\n", "utf-8"), ("\r\n", "utf-8-sig"), ("\n", "utf-16")):
        path.write_bytes(end.join(lines).encode(encoding))
        check(path)


def test_only_headers_that_name_a_whole_pose_count() -> None:
    for line in ("# timestamp x y theta", "# ground truth", "time,v_x,v_y,v_z,qw,qx,qy,qz", ""):
        assert columns_named_by(line) is None


@pytest.mark.parametrize(
    ("start", "step", "unit", "seconds"),
    [
        (1403636579763555584, 50_000_000, "nano", 0.05),
        (1403636579763555, 33_333, "micro", 0.033333),
        (1403636579763, 100, "milli", 0.1),
        # Since the computer was switched on, an hour ago or five days.
        (3_600_000_000_000, 50_000_000, "nano", 0.05),
        (432_000_000_000_000, 1_000_000, "nano", 0.001),
        (432_000_000_000, 100_000, "micro", 0.1),
    ],
)
def test_times_that_cannot_be_seconds(
    tmp_path: Path,
    start: int,
    step: int,
    unit: str,
    seconds: float,
    caplog: pytest.LogCaptureFixture,
) -> None:
    lines = [f"{start + step * index} {index} 0 0 0 0 0 1" for index in range(5)]
    (tmp_path / "poses").write_text("\n".join(lines))
    found = read_tum(tmp_path / "poses")
    np.testing.assert_allclose(np.diff(found.timestamps), seconds, atol=1e-6)
    assert caplog.messages == [f"{tmp_path / 'poses'}: times are taken for {unit}seconds"]


def test_lines_without_a_pose_are_gaps_and_are_numbered(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    lines = [
        "# a comment",
        "0.0 1 0 0 0 0 0 1",
        "0.1 0 0 0 0 0 0 0",
        "0.2 nan nan nan nan nan nan nan",
        "0.3 2 0 0 0 0 0 1  # found again",
        "nan nan nan nan nan nan nan nan",
        "0.5 3 0 0 0 0 inf 1",
        "0.6 4 0 0 0 0 0 1",
        "0.7,,,,,,,",
    ]
    (tmp_path / "poses").write_text("\n".join(lines))
    found = read_tum(tmp_path / "poses")
    assert found.timestamps.tolist() == [0.0, 0.3, 0.6]
    assert found.poses[:, 0, 3].tolist() == [1.0, 2.0, 4.0]
    said = "without a pose, and so a gap: lines 3 to 4, 6 to 7, 9"
    assert caplog.messages == [f"{tmp_path / 'poses'}: {said}"]
    (tmp_path / "none").write_text("0.0 0 0 0 0 0 0 0\n1.0 nan 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="holds no pose in 2 lines"):
        read_tum(tmp_path / "none")


def test_quaternions_before_positions_are_named(tmp_path: Path) -> None:
    (tmp_path / "poses").write_text("\n".join(" ".join(row) for row in rows("txyzwp")))
    with pytest.raises(InputError, match="here the first four after the time have length 1"):
        read_tum(tmp_path / "poses")


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    turned = scipy.spatial.transform.Rotation.random(4, random_state=1).as_quat()
    poses = pose_from_quaternion(POSES[:, :3, 3], turned)
    (tmp_path / "poses").write_text(format_tum(Trajectory(TIMES, poses)))
    check(tmp_path / "poses", poses=poses)
