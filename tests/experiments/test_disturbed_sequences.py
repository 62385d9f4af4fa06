"""Disturbed sequences: their images, their true poses, and their odometry."""

import importlib.util
import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.dataset.pairing import poses_at_images
from pipelines.experiments.disturbed_sequences import (
    COVER,
    DISTURBED,
    covered_middle,
    odometry_with_jumps,
    write_sequences,
)
from pipelines.geometry.pose import planar_state_of, world_from_base_planar
from pipelines.geometry.trajectory import Trajectory
from tests.chain_samples import ELEVATORS

RECORDED = load_dataset(ELEVATORS / "test")
NAMES = ("kidnapped", "dark", "covered-middle", "covered-right")
# Frames of the recorded sequence, in the order of the kidnapped one.
KIDNAPPED = (*range(10), 19, 18, 17, 16, 15)


@pytest.fixture(scope="module")
def sequences(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Dataset]:
    root = tmp_path_factory.mktemp("sequences") / "disturbed"
    written = write_sequences(
        ELEVATORS / "test", root, DISTURBED, overwrite=False, progress=no_progress
    )
    assert [path.name for path in written] == list(NAMES)
    return {path.name: load_dataset(path) for path in written}


def states(dataset: Dataset, trajectory: Trajectory | None) -> FloatArray:
    assert trajectory is not None
    return planar_state_of(poses_at_images(dataset, trajectory, "sequence"))


def motions(path: FloatArray) -> FloatArray:
    """Forward, left and yaw between poses, by plain trigonometry."""
    found = []
    for before, after in pairwise(path):
        dx, dy = after[:2] - before[:2]
        cos, sin = np.cos(before[2]), np.sin(before[2])
        yaw = (after[2] - before[2] + np.pi) % (2.0 * np.pi) - np.pi
        found.append((cos * dx + sin * dy, cos * dy - sin * dx, yaw))
    return np.array(found)


def test_the_truth_is_that_of_the_images(sequences: dict[str, Dataset]) -> None:
    recorded = states(RECORDED, RECORDED.groundtruth)
    kidnapped = sequences["kidnapped"]
    assert np.allclose(states(kidnapped, kidnapped.groundtruth), recorded[list(KIDNAPPED)])
    for number, source in enumerate(KIDNAPPED):
        assert kidnapped.read_image_bytes(number) == RECORDED.read_image_bytes(source)
    for name in NAMES[1:]:
        assert np.allclose(states(sequences[name], sequences[name].groundtruth), recorded)
        assert np.array_equal(sequences[name].timestamps, RECORDED.timestamps)
    assert all(sequence.camera == RECORDED.camera for sequence in sequences.values())


@pytest.mark.parametrize("name", ["odometry.txt", "odometry_perturbed.txt"])
def test_odometry_does_not_measure_the_jump(sequences: dict[str, Dataset], name: str) -> None:
    source = load_dataset(RECORDED.root, odometry=RECORDED.root / name)
    sequence = load_dataset(
        sequences["kidnapped"].root, odometry=sequences["kidnapped"].root / name
    )
    recorded = states(source, source.odometry)
    measured = motions(states(sequence, sequence.odometry))
    assert np.allclose(measured[:9], motions(recorded[:10]))
    assert np.allclose(measured[9], 0.0)
    assert np.allclose(measured[10:], motions(recorded[[19, 18, 17, 16, 15]]))
    dark = load_dataset(sequences["dark"].root, odometry=sequences["dark"].root / name)
    assert np.allclose(motions(states(dark, dark.odometry)), motions(recorded))


def test_five_images_in_the_middle_are_black(sequences: dict[str, Dataset]) -> None:
    dark = sequences["dark"]
    black = [number for number in range(len(dark)) if not dark.read_image(number).any()]
    assert black == [7, 8, 9, 10, 11]
    for number in set(range(20)) - set(black):
        assert dark.read_image_bytes(number) == RECORDED.read_image_bytes(number)


@pytest.mark.parametrize(("name", "inside"), [("middle", (240, 320)), ("right", (240, 500))])
def test_a_third_is_covered_in_every_image(
    sequences: dict[str, Dataset], name: str, inside: Sequence[int]
) -> None:
    sequence = sequences[f"covered-{name}"]
    for number in range(len(sequence)):
        image, recorded = sequence.read_image(number), RECORDED.read_image(number)
        covered = np.all(image == COVER, axis=2)
        assert covered.mean() == pytest.approx(1.0 / 3.0, abs=0.01)
        assert covered[tuple(inside)]
        assert not covered[:, :100].any()
        assert np.array_equal(image[~covered], recorded[~covered])


def test_covering_leaves_the_image_that_it_is_given() -> None:
    image = np.full((6, 9, 3), 7, dtype=np.uint8)
    assert np.count_nonzero(np.any(covered_middle(image) != 7, axis=2)) > 0
    assert np.all(image == 7)


def test_motion_goes_on_from_where_odometry_was() -> None:
    # Straight on, a metre a frame; carried away before the third frame, which looks elsewhere.
    path = world_from_base_planar(
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 5.0, 1.5], [5.0, 6.0, 1.5]])
    )
    found = planar_state_of(odometry_with_jumps(path, (0, 1, 3, 2), frozenset({2})))
    assert np.allclose(found[:3], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.allclose(found[3], [1.0 - np.sin(1.5), -np.cos(1.5), 0.0])


def test_what_cannot_be_used_is_said_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    specification = importlib.util.spec_from_file_location(
        "robustness", Path(__file__).parents[2] / "experiments/robustness.py"
    )
    assert specification is not None
    assert specification.loader is not None
    script = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(script)
    sequence = tmp_path / "sequence"
    shutil.copytree(ELEVATORS / "test", sequence)
    lines = (sequence / "rgb.txt").read_text().splitlines()
    (sequence / "rgb.txt").write_text("\n".join(lines[:13]) + "\n")
    with pytest.raises(InputError, match="has 12 frames, fewer than 15; give a longer sequence"):
        write_sequences(sequence, tmp_path / "out", DISTURBED, overwrite=True, progress=no_progress)
    (sequence / "groundtruth.txt").unlink()
    assert script.main([str(sequence), "-o", str(tmp_path / "out")]) == 1
    err = capsys.readouterr().err
    assert err == (
        f"robustness.py: {sequence}/groundtruth.txt: is missing: errors cannot be measured "
        "without it\n"
    )
    assert not (tmp_path / "out").exists()
