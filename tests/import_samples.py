"""Small sources for the tests of ``lfnav import``, and what they must become."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.dataset.images import encode_png
from pipelines.geometry.camera import Camera

SHARED = Path(__file__).parents[2] / "shared" / "data"


def picture(number: int, width: int = 32, height: int = 24) -> ImageArray:
    """Noise that differs from number to number."""
    generator = np.random.default_rng(number)
    return generator.integers(0, 256, (height, width, 3)).astype(np.uint8)


def write_picture(path: Path, number: int, width: int = 32, height: int = 24) -> bytes:
    """Writes a PNG, whatever the suffix is, and returns its bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = encode_png(picture(number, width, height))
    path.write_bytes(data)
    return data


def project(camera: Camera, world_from_camera: FloatArray, point: FloatArray) -> FloatArray:
    """Pixel of a world point, by the definitions alone; centres at integers, no distortion."""
    rotation, centre = world_from_camera[:3, :3], world_from_camera[:3, 3]
    x, y, z = rotation.T @ (point - centre)
    pinhole = camera.intrinsics
    return np.array([pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy])


def refusal(
    arguments: list[str], output: Path, capfd: pytest.CaptureFixture[str], code: int = 1
) -> str:
    """Runs ``lfnav import``, which must fail with one line and leave nothing behind."""
    before = sorted(output.parent.rglob("*"))
    assert common.run_command(main, ["import", *arguments, "-o", str(output)]) == code
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("lfnav: ")
    assert captured.err.count("\n") == 1, captured.err
    assert "internal error" not in captured.err
    assert sorted(output.parent.rglob("*")) == before
    return captured.err


def run_pycolmap(script: str, *arguments: Path) -> str:
    """Runs a script that uses pycolmap in a process of its own, where it may crash."""
    done = subprocess.run(
        [sys.executable, "-c", script, *map(os.fspath, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
