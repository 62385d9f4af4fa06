"""What a start of ``lfnav localize`` does without."""

import subprocess
import sys
from pathlib import Path

import pytest

from pipelines.lightfield.scene_file import save_scene
from tests.report_samples import wall_scene

SCRIPT = """
import sys
from pathlib import Path
import numpy as np
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.settings import LocalizerSettings
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo

settings = LocalizerSettings(start_particles=500)
rng = np.random.default_rng(0)
localizer = Localizer(load_scene(Path(sys.argv[1])), CAMERA, MOUNT, settings, rng)
record = localizer.step(photo(facing_wall(-0.4, 1.7, 0.15)))
assert record.estimates, record.status
print(*sorted(name for name in sys.modules if name.startswith("scipy.")), sep="\\n")
"""
# What ``import scipy`` itself loads.
ALLOWED = ("scipy.__config__", "scipy.version", "scipy._")


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    save_scene(tmp_path / "scene.h5", wall_scene(), overwrite=False)
    return tmp_path / "scene.h5"


def test_a_first_pose_loads_no_part_of_scipy(scene_file: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(scene_file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [name for name in done.stdout.split() if not name.startswith(ALLOWED)] == []
