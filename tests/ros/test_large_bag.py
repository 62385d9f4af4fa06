"""A bag of 2 GB: imported with little memory, and interrupted without a trace."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.camera import Camera
from tests.bag_samples import EPOCH, NS, Frame, Messages, circle, entries, small_drive

GIGABYTES, MEGABYTE = 2.0, 1024**2
SIZE = (960, 720)
# A shell's background processes ignore Ctrl-C; this one does not.
PROGRAM = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from lfnav_cli.common import run_command; from lfnav_cli.main import main; "
    "sys.exit(run_command(main))"
)


def write_large_bag(path: Path, gigabytes: float) -> int:
    """Writes raw images of noise, which cannot be compressed, and returns their number."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    messages = Messages(is_ros1=path.suffix == ".bag")
    width, height = SIZE
    count = int(gigabytes * 1e9 / (3 * width * height))
    camera = Camera("OPENCV", width, height, (700.0, 700.0, 479.5, 359.5, 0.0, 0.0, 0.0, 0.0))
    stamps = np.arange(EPOCH - NS, EPOCH + count * NS // 10 + NS, NS // 20)
    frames = tuple(Frame(EPOCH + index * NS // 10, b"") for index in range(count))
    drive = replace(small_drive(), camera=camera, frames=frames, odometry=circle(stamps))
    noise = np.random.default_rng(1).integers(0, 256, (height, width, 3)).astype(np.uint8)
    if messages.is_ros1:
        writer: object = Writer1(path)
        serialize = messages.store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
        writer = Writer2(path.with_suffix(""), version=9, storage_plugin=plugin)
        serialize = messages.store.serialize_cdr
    with writer as bag:  # type: ignore[attr-defined]
        connections = {}
        for topic, received, message in entries(drive, messages):
            name, content = topic, message
            if topic.endswith("/compressed"):
                stamp = message.header.stamp.sec * NS + message.header.stamp.nanosec
                name, content = "/camera/image_raw", messages.image(stamp, noise, "rgb8")
            kind = content.__msgtype__
            if name not in connections:
                connections[name] = bag.add_connection(name, kind, typestore=messages.store)
            bag.write(connections[name], received, serialize(content, kind))
    return count


def start(*arguments: str | Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drive.bag", "drive.db3", "drive.mcap"])
def test_a_large_bag_takes_little_memory_and_leaves_nothing_when_interrupted(
    tmp_path: Path, name: str
) -> None:
    if shutil.disk_usage(tmp_path).free < 5e9:
        pytest.skip("needs 5 GB of disk")
    count = write_large_bag(tmp_path / name, GIGABYTES)
    bag = tmp_path / name if name.endswith(".bag") else tmp_path / "drive"
    assert sum(file.stat().st_size for file in tmp_path.rglob("*") if file.is_file()) > 1.9e9
    before = sorted(tmp_path.rglob("*"))
    interrupted = start("import", bag, "-o", tmp_path / "out")
    try:
        while not list(tmp_path.glob(".out.*/rgb/*.png")):
            assert interrupted.poll() is None, interrupted.communicate()
            time.sleep(0.1)
        interrupted.send_signal(signal.SIGINT)
        _, err = interrupted.communicate(timeout=120)
    finally:
        interrupted.kill()
    assert (interrupted.returncode, err.strip()) == (130, "lfnav: interrupted")
    assert sorted(tmp_path.rglob("*")) == before
    # One image in fifty: all are read, few are encoded as PNG.
    process = start("import", bag, "-o", tmp_path / "out", "--every", "50")
    _, status, usage = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert len(load_dataset(tmp_path / "out")) == -(-count // 50)
    assert usage.ru_maxrss * 1024 <= 300 * MEGABYTE
