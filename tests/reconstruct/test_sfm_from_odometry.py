"""Structure from motion that starts from odometry: on the whole, in pieces, and after a kill."""

import dataclasses
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from lfnav_cli.common import run_command
from lfnav_cli.main import main
from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.pose import inverse, pose_from_rotation, rotation_angle
from pipelines.geometry.trajectory import read_tum
from pipelines.reconstruct.alignment import Similarity
from pipelines.reconstruct.colmap_model import ColmapModel, read_model, write_model
from pipelines.reconstruct.connectivity import restrict
from pipelines.reconstruct.odometry_mapping import beside_the_others
from pipelines.reconstruct.pieces import firm_parts, moved, put_together
from pipelines.reconstruct.pose_graph import Drift
from pipelines.reconstruct.reconstruction import load_reconstruction, save_reconstruction
from pipelines.reconstruct.retrieval import PossiblePairs, alike_pairs
from pipelines.reconstruct.settings import ReconstructSettings
from pipelines.reconstruct.sfm import starts_from_odometry
from pipelines.reconstruct.stage import UNFINISHED_SUFFIX, reconstruct
from tests.reconstruct_samples import SAMPLES, part_of, random_poses, small_reconstruction

WORKSHOP = SAMPLES / "workshop" / "map"
FILES = ["camera.toml", "odometry.txt", "groundtruth.txt"]
MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin")


SETTINGS = ReconstructSettings("sfm", matcher="spatial", max_features=1000, max_size=480)
T = TypeVar("T")


def arguments(dataset: Path, output: Path) -> list[str]:
    options = ["--method", "sfm", "--matcher", "spatial", "--max-features", "1000"]
    return ["reconstruct", str(dataset), "-o", str(output), *options, "--max-size", "480"]


def test_it_is_killed_and_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    part_of(WORKSHOP, tmp_path / "d", range(10, 18), FILES)
    command = [sys.executable, "-m", "lfnav_cli.main", *arguments(tmp_path / "d", tmp_path / "r")]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as first:
        while first.poll() is None and not any(tmp_path.rglob("round-0")):
            time.sleep(0.01)
        first.send_signal(signal.SIGKILL)
    unfinished = tmp_path / f"r{UNFINISHED_SUFFIX}"
    assert not (tmp_path / "r").exists()
    kept = [path for name in ("database.db", "round-0") for path in unfinished.rglob(name)]
    assert len(kept) == 2
    before = [path.stat().st_ino for path in kept]
    during = []

    def watching(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
        for item in items:
            if "mapping" in description:
                during.append([path.stat().st_ino for path in kept])
            yield item

    reconstruct(tmp_path / "d", tmp_path / "r", SETTINGS, progress=watching)
    assert during[0] == during[-1] == before
    assert not unfinished.exists()
    assert run_command(main, arguments(tmp_path / "d", tmp_path / "whole")) == 0
    for name in MODEL_FILES:
        again = (tmp_path / "r" / "sparse" / name).read_bytes()
        assert again == (tmp_path / "whole" / "sparse" / name).read_bytes()

    found = load_reconstruction(tmp_path / "r")
    truth = read_tum(WORKSHOP / "groundtruth.txt")
    true = truth.poses[truth.nearest(found.timestamps, 1e-3)]
    assert len(found.image_names) == 8
    assert found.scale_source == "odometry"
    assert found.statistics["mapper"] == "from odometry"
    assert found.statistics["pieces"] == [8]
    centres = found.world_from_camera[:, :3, 3]
    assert np.linalg.norm(centres - true[:, :3, 3], axis=1).max() < 0.035
    assert np.degrees(rotation_angle(inverse(true) @ found.world_from_camera)).max() < 0.6


def test_by_default_many_photos_with_odometry_and_a_camera_start_from_it(tmp_path: Path) -> None:
    part_of(WORKSHOP, tmp_path / "few", range(10, 18), FILES)
    few = load_dataset(tmp_path / "few")
    auto, spatial = ReconstructSettings("sfm"), ReconstructSettings("sfm", matcher="spatial")
    assert not starts_from_odometry(few, auto)
    assert starts_from_odometry(few, spatial)
    many = dataclasses.replace(
        few,
        image_names=tuple(f"{index:04d}.jpg" for index in range(200)),
        timestamps=np.linspace(few.timestamps[0], few.timestamps[-1], 200),
    )
    assert not starts_from_odometry(many, auto)  # most of them have no odometry
    assert few.odometry is not None
    odometry = dataclasses.replace(
        few.odometry, timestamps=many.timestamps, poses=np.tile(np.eye(4), (200, 1, 1))
    )
    whole = dataclasses.replace(many, odometry=odometry)
    assert starts_from_odometry(whole, auto)
    assert not starts_from_odometry(whole, ReconstructSettings("sfm", matcher="sequential"))
    assert not starts_from_odometry(dataclasses.replace(whole, camera=None), auto)


@pytest.mark.parametrize("missing", ["odometry.txt", "camera.toml"])
def test_without_odometry_or_camera_it_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: str
) -> None:
    files = [name for name in FILES if name != missing]
    part_of(WORKSHOP, tmp_path / "d", range(10, 14), files)
    assert run_command(main, arguments(tmp_path / "d", tmp_path / "r")) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert missing in error
    assert "--matcher spatial" in error
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_photos_look_alike_only_where_they_may_be_near() -> None:
    generator = np.random.default_rng(0)
    kinds = generator.normal(size=(6, 64))
    descriptors = np.repeat(kinds, 2, axis=0) + 0.1 * generator.normal(size=(12, 64))
    descriptors = (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype("f4")
    poses = np.tile(np.eye(4), (12, 1, 1))
    poses[:, 0, 3] = np.arange(12) % 2 * 5.0
    path = np.arange(12.0)
    poses[10:, 0, 3] = 0.0
    possible = PossiblePairs(poses, path, 2.0, Drift(0.5, 0.0, 0.0, 0.0))
    assert (10, 11) in alike_pairs(descriptors, possible)
    assert (0, 1) not in alike_pairs(descriptors, possible)
    drifted = PossiblePairs(poses, path, 2.0, Drift(4.0, 0.0, 0.0, 0.0))
    assert {(0, 1), (2, 3), (10, 11)} <= set(alike_pairs(descriptors, drifted))


def test_held_photos_keep_their_place_beside_their_neighbours() -> None:
    before = random_poses(5)
    turn = random_poses(1, seed=9)[0]
    placed = beside_the_others(
        np.concatenate([turn @ before[:2], before[2:3], turn @ before[3:]]), before, [2]
    )
    np.testing.assert_allclose(placed, turn @ before, atol=1e-9)


def two_pieces(folder: Path) -> ColmapModel:
    """A model of ten images whose first six see nothing that the last four see."""
    groups = [(0, 1, 2, 3, 4, 5)] * 50 + [(6, 7, 8, 9)] * 50
    rows = [(point, image) for point, group in enumerate(groups) for image in group]
    base = small_reconstruction(folder, images=10, points=len(groups))
    content = dataclasses.replace(
        base,
        image_names=tuple(f"{index:06d}.jpg" for index in range(10)),
        observations=np.array(rows, dtype=np.int64),
        observed_pixels=np.zeros((len(rows), 2)),
    )
    save_reconstruction(folder / "r", content, {}, overwrite=False)
    return read_model(folder / "r" / "sparse")


def camera_poses(model: ColmapModel) -> FloatArray:
    return inverse(np.array([image.camera_from_world for image in model.images]))


def test_pieces_are_put_together_through_odometry(tmp_path: Path) -> None:
    model = two_pieces(tmp_path)
    world = camera_poses(model)
    first, second = firm_parts(model)
    assert [len(part.images) for part in (first, second)] == [6, 4]
    # Each piece has got a scale and a frame of its own.
    turn = random_poses(2, seed=3)
    into_first = Similarity(0.5, turn[0, :3, :3], turn[0, :3, 3])
    into_second = Similarity(2.0, turn[1, :3, :3], turn[1, :3, 3])
    parts = [moved(first, into_first), moved(second, into_second)]
    rotation = turn[0, :3, :3].T
    back = Similarity(2.0, rotation, -2.0 * rotation @ turn[0, :3, 3])
    # Odometry's world is another one; what counts is how it goes on from photo to photo.
    odometry = pose_from_rotation(np.tile(turn[1, :3, :3], (10, 1, 1)), np.ones((10, 3))) @ world
    names = [image.name for image in model.images]
    found = put_together(model, parts, back, dict(zip(names, odometry, strict=True)))
    assert found.pieces == [6, 4]
    assert found.lone == 0
    whole = found.model
    np.testing.assert_allclose(camera_poses(whole), world, atol=1e-6)
    np.testing.assert_allclose(whole.points.positions, model.points.positions, atol=1e-6)
    (tmp_path / "whole").mkdir()
    write_model(tmp_path / "whole", whole)
    assert len(read_model(tmp_path / "whole").points.tracks) == len(model.points.tracks)


def test_a_photo_of_a_bare_wall_is_placed_beside_its_neighbours(tmp_path: Path) -> None:
    model = two_pieces(tmp_path)
    rows = [0, 1, 2, 3, 4, 5]
    first = restrict(model, rows)
    same = Similarity(1.0, np.eye(3), np.zeros(3))
    near = {image.name: pose for image, pose in zip(model.images, camera_poses(model), strict=True)}
    steps = np.tile(np.eye(4), (10, 1, 1))
    steps[:, 0, 3] = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.5, 4.4, 5.4, 6.0]
    odometry = dict(zip(near, steps, strict=True))
    whole = put_together(model, [first], same, odometry)
    # Number 8 is a walk of 2.9 m away, and the next one more.
    assert whole.lone == 2
    assert [image.name for image in whole.model.images] == list(near)[:8]
    expected = near["000005.jpg"] @ inverse(steps[5]) @ steps[7]
    np.testing.assert_allclose(camera_poses(whole.model)[7], expected, atol=1e-9)
    (tmp_path / "whole").mkdir()
    write_model(tmp_path / "whole", whole.model)
    assert len(read_model(tmp_path / "whole").images) == 8
