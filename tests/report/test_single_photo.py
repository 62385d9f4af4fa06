"""``lfnav localize SCENE PHOTO``: where a photo was taken, told and drawn."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.pose import inverse, rotation_angle
from pipelines.geometry.trajectory import read_tum
from pipelines.localize.run import load_run
from tests.chain_samples import ELEVATORS, lfnav, map_elevators, succeed

PHOTO, ROW = ELEVATORS / "test" / "rgb" / "0003.jpg", 3
ELSEWHERE = ELEVATORS.parent / "workshop" / "map" / "rgb" / "0002.jpg"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return map_elevators(tmp_path_factory.mktemp("lobby"))


def true_pose() -> FloatArray:
    """Of the camera: the robot's, and the mount of its camera.toml."""

    data = load_dataset(ELEVATORS / "test")
    poses = read_tum(ELEVATORS / "test" / "groundtruth.txt").poses
    return np.asarray(poses[ROW] @ data.body_from_camera)


def test_it_is_found_and_drawn(scene: Path, tmp_path: Path) -> None:
    run_path, picture = tmp_path / "run.h5", tmp_path / "beside.png"
    command = ("localize", scene, PHOTO, "-o", run_path, "--picture", picture, "--json")
    answer = json.loads(succeed(*command))
    assert answer["answer"] == "found"
    assert answer["confidence"] > 0.9
    pose = np.array(answer["world_from_camera"])
    truth = true_pose()
    assert np.linalg.norm(pose[:3, 3] - truth[:3, 3]) < 0.1
    assert np.degrees(rotation_angle(inverse(truth) @ pose)) < 3.0
    assert np.array(answer["covariance"]).shape == (6, 6)
    # Three pictures side by side.
    drawn = Image.open(io.BytesIO(picture.read_bytes()))
    assert drawn.width > 3 * drawn.height
    run = load_run(run_path)
    np.testing.assert_allclose(run.space.poses(run.estimated_states())[0], pose)
    assert "report.html" in succeed("report", run_path, "-o", tmp_path / "report")


def test_the_table_says_it_in_words(scene: Path) -> None:
    told = succeed("localize", scene, PHOTO)
    assert "found" in told
    assert "looks to" in told
    assert "the map's, of the same size" in told


def test_a_photo_of_elsewhere_is_not_placed(scene: Path, tmp_path: Path) -> None:
    picture = tmp_path / "beside.png"
    answer = json.loads(succeed("localize", scene, ELSEWHERE, "--json", "--picture", picture))
    assert answer["answer"] == "not found in the map"
    assert answer["world_from_camera"] is None
    assert answer["covariance"] is None
    assert picture.exists()


def test_a_focal_length_of_exif_data_is_made_exact_by_features(scene: Path, tmp_path: Path) -> None:
    """A phone's photo in another size; 33 mm are five percent less than the lens had."""
    path = tmp_path / "phone.jpg"
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 33
    with Image.open(PHOTO) as photo:
        photo.resize((480, 360), Image.Resampling.BOX).save(path, exif=exif, quality=95)
    answer = json.loads(succeed("localize", scene, path, "--json"))
    stated = 33.0 / np.hypot(36.0, 24.0) * np.hypot(480, 360)
    true = 577.295 * 480 / 640
    assert abs(stated / true - 1.0) > 0.04
    assert abs(answer["camera"]["params"][0] / true - 1.0) < 0.02
    assert answer["answer"] == "found"
    assert np.linalg.norm(np.array(answer["position_m"]) - true_pose()[:3, 3]) < 0.1


def test_wrong_usage_is_one_line(scene: Path, tmp_path: Path) -> None:
    for options, said in (
        (("--odometry", tmp_path / "o.txt"), "--odometry is of no use"),
        (("--degrees-of-freedom", "3"), "6 degrees of freedom"),
        (("--picture", tmp_path / "p.txt"), "the picture is a PNG"),
    ):
        outcome = lfnav("localize", scene, PHOTO, *options)
        assert outcome.code in (1, 2)
        assert said in outcome.err
        assert outcome.err.count("\n") == 1
    outcome = lfnav(
        "localize", scene, ELEVATORS / "test", "-o", tmp_path / "r.h5", "--camera", tmp_path / "c"
    )
    assert outcome.code == 2
    assert "a photo by itself" in outcome.err
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(PHOTO.read_bytes()[:3000])
    outcome = lfnav("localize", scene, broken)
    assert outcome.code == 1
    assert "broken.jpg" in outcome.err
    assert outcome.err.count("\n") == 1
