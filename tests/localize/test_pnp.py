"""The pose by features: right where it has one, and none where the image shows something else."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dataset.images import encode_png
from pipelines.geometry.interpolation import PAIRING_TOLERANCE
from pipelines.geometry.pose import inverse, pose_from_rotation
from pipelines.lightfield.local_features import find_features
from pipelines.lightfield.scene_file import save_scene
from pipelines.localize.feature_pose import match, pose_covariance
from pipelines.localize.pnp import MIN_INLIERS, PnpAnswer, PnpLocalizer, covariance_at
from pipelines.localize.run import load_run
from pipelines.localize.state_space import PLANAR, SPATIAL, StateSpace
from tests.chain_samples import first_frames, lfnav, succeed
from tests.lightfield_samples import looking
from tests.pnp_samples import FRAMES, SEQUENCE, WORKSHOP, workshop_finder, workshop_scene
from tests.reconstruct_samples import texture

ROOT = Path(__file__).parents[2]
SCENE = workshop_scene()


@pytest.fixture(scope="module")
def finder() -> PnpLocalizer:
    return workshop_finder(SCENE)


def true_state(frame: int, space: StateSpace) -> FloatArray:
    assert SEQUENCE.groundtruth is not None
    nearest = SEQUENCE.groundtruth.nearest(SEQUENCE.timestamps[[frame]], PAIRING_TOLERANCE)
    return space.states(SEQUENCE.groundtruth.poses[nearest[0]])


def errors(answer: PnpAnswer, frame: int, space: StateSpace) -> tuple[float, float]:
    """Metres and degrees."""
    assert answer.state is not None
    offset = space.difference(answer.state, true_state(frame, space))
    metres = float(np.linalg.norm(offset[: space.positions]))
    return metres, math.degrees(float(np.linalg.norm(offset[space.positions :])))


def test_the_robot_is_found_in_frames_of_the_drive(finder: PnpLocalizer) -> None:
    for frame in FRAMES:
        answer = finder.locate(SEQUENCE.read_image(frame))
        metres, degrees = errors(answer, frame, PLANAR)
        assert metres < 0.05
        assert degrees < 1.0
        assert answer.inliers >= MIN_INLIERS
        assert answer.confidence == answer.inliers / (answer.inliers + 30.0)


@pytest.mark.parametrize("kind", ["black", "noise", "smooth noise"])
def test_an_image_of_nothing_has_no_pose(finder: PnpLocalizer, kind: str) -> None:
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    random = np.random.default_rng(4)
    if kind == "noise":
        image = random.integers(0, 256, (480, 640, 3), dtype=np.uint8)
    if kind == "smooth noise":
        coarse = random.integers(0, 256, (48, 64, 3), dtype=np.uint8)
        image = np.kron(coarse, np.ones((10, 10, 1), dtype=np.uint8))
    answer = finder.locate(image)
    assert answer.state is None
    assert answer.covariance is None
    assert answer.inliers < MIN_INLIERS
    assert answer.confidence == 0.0


def test_the_same_image_has_the_same_pose_with_any_number_of_threads(finder: PnpLocalizer) -> None:
    image = SEQUENCE.read_image(FRAMES[0])
    first = finder.locate(image)
    second = workshop_finder(SCENE, threads=1).locate(image)
    assert first.state is not None
    assert second.state is not None
    assert first.state.tobytes() == second.state.tobytes()
    assert (first.inliers, first.matches) == (second.inliers, second.matches)


def test_six_degrees_of_freedom_take_what_a_robot_on_the_floor_cannot_be() -> None:
    image = SEQUENCE.read_image(FRAMES[0])
    answer = workshop_finder(SCENE, SPATIAL, height=0.5).locate(image)
    assert answer.state is not None
    truth = true_state(FRAMES[0], SPATIAL)
    truth[2] += 0.5
    offset = SPATIAL.difference(answer.state, truth)
    assert np.linalg.norm(offset[:3]) < 0.05
    assert np.linalg.norm(offset[3:]) < math.radians(1.0)
    refused = workshop_finder(SCENE, PLANAR, height=0.5).locate(image)
    assert refused.state is None
    assert refused.inliers == answer.inliers


def test_an_image_of_another_size_is_refused(finder: PnpLocalizer) -> None:
    with pytest.raises(OptionError, match="image is 64x48, its camera 640x480"):
        finder.locate(np.zeros((48, 64, 3), dtype=np.uint8))


TOGETHER = """
import sys
import numpy as np
if sys.argv[1] == "pycolmap first":
    import pycolmap
from pipelines.localize.localizer import Localizer
import pycolmap
from pipelines.localize.settings import LocalizerSettings
from tests.pnp_samples import SEQUENCE, FRAMES, workshop_finder, workshop_scene
scene, image = workshop_scene(), SEQUENCE.read_image(FRAMES[0])
localizer = Localizer(
    scene, SEQUENCE.camera, SEQUENCE.base_from_camera, LocalizerSettings(), np.random.default_rng(0)
)
localizer.step(image, None)
grey = np.ascontiguousarray(image.mean(axis=2), dtype=np.float32) / 255.0
assert len(pycolmap.Sift().extract(grey)[0]) > 100
localizer.step(image, np.zeros(3))
assert workshop_finder(scene).locate(image).state is not None
"""


@pytest.mark.parametrize("order", ["pycolmap first", "lfnav first"])
def test_pycolmap_and_the_filter_share_a_process(order: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", TOGETHER, order], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_matches_are_the_best_both_ways_and_clearly_so() -> None:
    first = np.eye(4, dtype=np.float32)
    second = np.array(
        [[0, 1, 0, 0], [1, 0, 0, 0], [0.8, 0.6, 0, 0], [0, 0, 0.7, 0.714], [0, 0, 0.714, 0.7]],
        dtype=np.float32,
    )
    # Rows 2 and 3 have two neighbours that are nearly as good as each other.
    assert match(first, second).tolist() == [[0, 1], [1, 0]]
    # Two features of one image cannot be the same feature of another.
    twice = np.concatenate([first[:1], np.array([[0.96, 0.28, 0, 0]], dtype=np.float32)])
    assert match(twice, second[1:2]).tolist() == [[0, 0]]
    assert match(twice, second[1:2], mutual=False).tolist() == [[0, 0], [1, 0]]
    assert match(first[:0], second).shape == match(first, second[:0]).shape == (0, 2)


class _Pinhole:
    """A camera of focal length 500, as pycolmap's behaves."""

    def img_from_cam(self, points: FloatArray) -> FloatArray:
        return 500.0 * points[:, :2] / points[:, 2:] + [320.0, 240.0]


@pytest.mark.parametrize("max_size", [480, 240])
def test_masked_features_are_left_out_and_do_not_count(max_size: int) -> None:
    grey = np.ascontiguousarray(texture(360, 480)[:, :, 0])
    used = np.ones((360, 480), dtype=np.uint8)
    used[:, :160] = 0
    found = find_features(grey, max_size, 100, used)
    # Half a pixel of the reduced image may reach over.
    assert found.pixels[:, 0].min() > 159.0 - 0.5 * 480 / max_size
    # The strongest of those that remain, not those that remain of the strongest.
    everywhere = find_features(grey, max_size, 0)
    inside = everywhere.pixels[:, 0] > 161.0 + 480 / max_size
    assert np.count_nonzero(inside) > 100
    assert len(found.pixels) == 100
    known = {tuple(pixel) for pixel in everywhere.pixels}
    assert all(tuple(pixel) in known for pixel in found.pixels)
    plain = find_features(grey, max_size, 100)
    whole = find_features(grey, max_size, 100, np.ones_like(used))
    np.testing.assert_array_equal(whole.pixels, plain.pixels[:100])


def test_a_mask_holds_for_camera_images_and_not_for_the_map() -> None:
    frame = FRAMES[0]
    image = SEQUENCE.read_image(frame).copy()
    mask = np.ones(image.shape[:2], dtype=np.bool_)
    mask[:, :213] = False
    # The board on the robot shows a piece of another photo of the map.
    image[:, :213] = SEQUENCE.read_image(FRAMES[1])[:, :213]
    finder = workshop_finder(SCENE, mask=mask)
    answer = finder.locate(image)
    assert answer.inliers >= MIN_INLIERS
    assert errors(answer, frame, PLANAR)[0] < 0.05
    # What is masked changes nothing but features at the border.
    image[:, :150] = 0
    assert errors(finder.locate(image), frame, PLANAR)[0] < 0.05
    assert workshop_finder(SCENE, mask=~mask).locate(image).state is None
    with pytest.raises(OptionError, match="the mask has the shape"):
        workshop_finder(SCENE, mask=mask[1:])


def test_the_covariance_is_that_of_poses_from_noisy_pixels() -> None:
    random = np.random.default_rng(6)
    world_from_camera = looking([1.0, -3.0, 1.2], [0.5, 0.0, 0.8])
    points = np.array([0.5, 0.0, 0.8]) + random.uniform(-0.9, 0.9, (40, 3))
    camera = _Pinhole()

    def projected(offset: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(offset[3:]).as_matrix() @ world_from_camera[:3, :3]
        moved = pose_from_rotation(turned, world_from_camera[:3, 3] + offset[:3])
        matrix = inverse(moved)
        return camera.img_from_cam(points @ matrix[:3, :3].T + matrix[:3, 3])

    exact = projected(np.zeros(6))
    found, stated = [], []
    for _ in range(150):
        pixels = exact + random.normal(0.0, 0.7, exact.shape)

        def left(offset: FloatArray, pixels: FloatArray = pixels) -> FloatArray:
            return (projected(offset) - pixels).ravel()

        solution = least_squares(left, np.zeros(6))
        found.append(solution.x)
        stated.append(pose_covariance(camera, inverse(world_from_camera)[:3], pixels, points))
    whitened = np.linalg.cholesky(np.linalg.inv(np.mean(stated, axis=0))).T @ np.array(found).T
    np.testing.assert_allclose(np.cov(whitened), np.eye(6), atol=0.45)

    # The same at the end of an arm, a body that turns with the camera.
    camera_from_body = pose_from_rotation(np.eye(3), np.array([0.4, -0.8, -0.3]))
    bodies = []
    for offset in np.array(found):
        turned = Rotation.from_rotvec(offset[3:]).as_matrix() @ world_from_camera[:3, :3]
        pose = pose_from_rotation(turned, world_from_camera[:3, 3] + offset[:3])
        bodies.append(SPATIAL.states(pose @ camera_from_body))
    body = SPATIAL.states(world_from_camera @ camera_from_body)
    arm = body[:3] - world_from_camera[:3, 3]
    expected = covariance_at(arm, np.cov(np.array(found).T))
    measured = np.cov(SPATIAL.difference(np.array(bodies), body).T)
    np.testing.assert_allclose(measured, expected, rtol=0.02, atol=1e-3 * expected.max())


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the scene, and three frames of the sequence of which the last shows nothing."""
    folder = tmp_path_factory.mktemp("workshop")
    save_scene(folder / "scene.h5", SCENE, overwrite=False)
    sequence = first_frames(WORKSHOP / "test", folder / "drive", 3)
    black = encode_png(np.zeros((480, 640, 3), dtype=np.uint8))
    name = (sequence / "rgb.txt").read_text(encoding="utf-8").splitlines()[2].split()[1]
    (sequence / name).write_bytes(black)
    return folder


def test_a_run_of_poses_by_features(workshop: Path, tmp_path: Path) -> None:
    for path in (workshop / "drive").glob("odometry*.txt"):
        path.unlink()
    scene, run_path = workshop / "scene.h5", tmp_path / "run.h5"
    succeed("localize", scene, workshop / "drive", "-o", run_path, "--method", "pnp")
    run = load_run(run_path)
    assert run.default_estimate == "pnp"
    assert [frame.status for frame in run.frames] == ["tracking", "tracking", "lost"]
    for number, frame in enumerate(run.frames[:2]):
        assert len(frame.particles) == 1
        offset = frame.estimates["pnp"] - true_state(number, PLANAR)
        assert np.linalg.norm(offset[:2]) < 0.05
        assert abs(offset[2]) < math.radians(1.0)
        # The stated covariance covers the error.
        assert offset @ np.linalg.solve(frame.covariance, offset) < 25.0
    lost = run.frames[2]
    assert not lost.estimates
    assert lost.confidence == 0.0
    # Anywhere: as wide as the area, in all directions.
    assert np.all(np.ptp(lost.particles, axis=0) > 0.9 * np.array([8.0, 5.0, 2.0 * np.pi]))

    table = succeed("evaluate", run_path)
    assert "estimate (pnp): position (m)" in table
    assert "2 of 3 (67 %)" in table
    figures = json.loads(succeed("evaluate", run_path, "--json"))
    assert figures["pnp"]["share_with_pose"] == pytest.approx(2 / 3)
    assert figures["frames_without_estimate"] == 1


def test_a_run_of_poses_by_features_uses_the_mask(workshop: Path, tmp_path: Path) -> None:
    scene, run_path = workshop / "scene.h5", tmp_path / "run.h5"
    grey = np.zeros((480, 640), dtype=np.uint8)
    grey[:, 600:] = 255
    (tmp_path / "mask.png").write_bytes(encode_png(grey))
    mask = ("--mask", tmp_path / "mask.png")
    succeed("localize", scene, workshop / "drive", "-o", run_path, "--method", "pnp", *mask)
    # What is left of the images is too narrow.
    assert [frame.status for frame in load_run(run_path).frames] == ["lost"] * 3


def test_points_of_a_reconstruction_are_for_pnp_alone(workshop: Path, tmp_path: Path) -> None:
    scene, sequence = workshop / "scene.h5", workshop / "drive"
    arguments = (
        "localize",
        scene,
        sequence,
        "-o",
        tmp_path / "run.h5",
        "--reconstruction",
        tmp_path,
    )
    outcome = lfnav(*arguments)
    assert outcome.code != 0
    assert "a reconstruction is of use to PnP alone" in outcome.err
    outcome = lfnav(*arguments, "--method", "pnp")
    assert "is not a reconstruction" in outcome.err
    assert not (tmp_path / "run.h5").exists()
