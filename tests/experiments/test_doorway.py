"""The doorway: its scene is what its program makes, and nothing is touched unseen."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


def experiment(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "experiments" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def doorway() -> Any:
    return experiment("doorway")


@pytest.fixture(scope="module")
def docking() -> Any:
    return experiment("docking")


def test_the_sample_scene_is_what_the_program_makes(doorway: Any) -> None:
    folder = ROOT / "sample_data" / "doorway" / "scene"
    written = (folder / "scene.xml").read_text(encoding="utf-8")
    assert written == doorway.scene_xml()
    for texture in re.findall(r'value="(textures/\w+\.jpg)"', written):
        assert (folder / texture).is_file()


def test_distances_are_from_the_pillars_of_the_scene(doorway: Any, docking: Any) -> None:
    middle, before = [0.0, doorway.PILLAR_Y], [0.0, doorway.PILLAR_Y - doorway.HALF_WIDTH - 0.3]
    corner = np.hypot(doorway.PASSAGE / 2.0, 0.3)
    touching = [doorway.PILLAR_X - doorway.HALF_WIDTH, doorway.PILLAR_Y]
    found = docking.pillar_distance(np.array([middle, before, touching]))
    np.testing.assert_allclose(found, [doorway.PASSAGE / 2.0, corner, 0.0], atol=1e-9)


def test_what_is_nearest_is_sought_between_the_images_too(docking: Any) -> None:
    # Past the left pillar in a single step: neither end is near it.
    states = [np.array([-0.2, -3.0, 1.5]), np.array([-0.2, -1.0, 1.5])]
    entries = [SimpleNamespace(true_state=state) for state in states]
    summary = SimpleNamespace(docking=SimpleNamespace(entries=entries))
    assert docking.nearest(docking.DOORWAY, summary) == pytest.approx(0.25, abs=0.005)


def test_the_starts_see_the_wall_or_none_of_it(docking: Any) -> None:
    for row in docking.ROWS.values():
        for state in docking.starts(row, 5):
            share = docking.wall_share(row.place, state)
            assert share > 0.25 if row.sees_wall else share == 0.0
