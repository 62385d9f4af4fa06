"""Sequences whose images do not show the place: their images, poses and odometry."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.experiments.disturbed_sequences import write_sequences
from pipelines.experiments.null_images import RECORD, null_image_disturbances, null_images
from tests.chain_samples import ELEVATORS, first_frames

ROOT = Path(__file__).parents[2]
ELSEWHERE = ("mirrored", "upside-down", "negative", "noise", "grey", "ramp", "stripes")
FRAMES = 10


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """With images of a quarter of the width: eight drives are made of them, four times."""
    folder = first_frames(ELEVATORS / "test", tmp_path_factory.mktemp("recorded") / "drive", FRAMES)
    for path in (folder / "rgb").iterdir():
        with Image.open(path) as image:
            smaller = image.reduce(4)
        smaller.save(path)
    text = (ELEVATORS / "test/camera.toml").read_text(encoding="utf-8")
    for before, after in (
        ("width = 640", "width = 160"),
        ("height = 480", "height = 120"),
        ("577.295282, 577.295282, 319.500000, 239.500000", "144.323821, 144.323821, 79.5, 59.5"),
    ):
        assert before in text
        text = text.replace(before, after)
    (folder / "camera.toml").write_text(text, encoding="utf-8")
    return load_dataset(folder)


@pytest.fixture(scope="module")
def sequences(recorded: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Dataset]:
    output = tmp_path_factory.mktemp("troubles") / "made"
    paths = write_sequences(
        recorded.root, output, null_images(3), overwrite=False, progress=no_progress
    )
    assert (output / RECORD).is_file()
    return {path.name: load_dataset(path) for path in paths}


def test_all_have_the_recorded_odometry_and_camera(
    recorded: Dataset, sequences: dict[str, Dataset]
) -> None:
    assert tuple(sequences) == ("frozen", *ELSEWHERE)
    for sequence in sequences.values():
        assert sequence.camera == recorded.camera
        assert np.array_equal(sequence.timestamps, recorded.timestamps)
        assert sequence.odometry is not None
        assert recorded.odometry is not None
        assert np.allclose(sequence.odometry.poses, recorded.odometry.poses[:FRAMES], atol=1e-9)
        assert (sequence.root / "odometry_perturbed.txt").is_file()


def test_images_that_show_no_place_have_no_true_pose(sequences: dict[str, Dataset]) -> None:
    assert all(sequences[name].groundtruth is None for name in ELSEWHERE)


def test_a_frozen_camera_repeats_an_image_while_the_robot_drives_on(
    recorded: Dataset, sequences: dict[str, Dataset]
) -> None:
    frozen = sequences["frozen"]
    shown = (0, 1, 1, 1, 1, 1, 1, 1, 8, 9)
    for number, source in enumerate(shown):
        assert frozen.read_image_bytes(number) == recorded.read_image_bytes(source)
    assert frozen.groundtruth is not None
    assert recorded.groundtruth is not None
    assert np.allclose(frozen.groundtruth.poses, recorded.groundtruth.poses[:FRAMES], atol=1e-9)
    # In a sequence of twenty frames, 6 is shown in the place of 7 to 12.
    assert null_image_disturbances(20)[0].shown == (*range(7), *(6,) * 6, *range(13, 20))


def test_images_are_altered_as_they_say(recorded: Dataset, sequences: dict[str, Dataset]) -> None:
    for number in (0, FRAMES - 1):
        before = recorded.read_image(number)
        after = {name: sequences[name].read_image(number) for name in ELSEWHERE}
        assert np.array_equal(after["mirrored"], before[:, ::-1])
        assert np.array_equal(after["upside-down"], before[::-1, ::-1])
        assert np.array_equal(after["negative"].astype(int), 255 - before.astype(int))
        assert np.unique(after["grey"]).tolist() == [128]
        # Uniform from 0 to 255, pixels independent.
        noise = after["noise"].astype(float)
        assert noise.std() == pytest.approx(255 / np.sqrt(12), rel=0.01)
        assert abs(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]) < 0.01
        ramp = after["ramp"].astype(float)
        assert (ramp.min(), ramp.max()) == (40.0, 215.0)
        assert np.abs(np.diff(ramp[..., 0], axis=0)).max() <= 2.0
        assert np.abs(np.diff(ramp[..., 0], axis=1)).max() <= 2.0
        assert np.unique(after["stripes"]).tolist() == [60, 195]


def test_random_images_differ_and_a_seed_reproduces_them(
    recorded: Dataset, sequences: dict[str, Dataset], tmp_path: Path
) -> None:
    for name in ("noise", "ramp", "stripes"):
        assert sequences[name].read_image_bytes(0) != sequences[name].read_image_bytes(1)
    for seed, same in ((3, True), (4, False)):
        write_sequences(
            recorded.root,
            tmp_path / "again",
            null_images(seed),
            overwrite=True,
            progress=no_progress,
        )
        for name in ("noise", "ramp", "stripes"):
            again = load_dataset(tmp_path / "again" / name).read_image_bytes(2)
            assert (again == sequences[name].read_image_bytes(2)) is same


def test_the_script_prints_its_folders_and_its_errors(
    recorded: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script: dict[str, Any] = runpy.run_path(str(ROOT / "experiments/troubles.py"))
    output = tmp_path / "out"
    assert script["main"]([str(recorded.root), "-o", str(output)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == str(output / "frozen")
    short = first_frames(ELEVATORS / "test", tmp_path / "short", 7)
    assert script["main"]([str(short), "-o", str(tmp_path / "no")]) == 1
    assert "has 7 frames, fewer than 8; give a longer sequence" in capsys.readouterr().err
    assert script["main"]([str(recorded.root), "-o", str(tmp_path / "no"), "--seed=-1"]) == 1
    assert capsys.readouterr().err == "troubles.py: seed -1 is negative\n"
    assert not (tmp_path / "no").exists()
