"""What a mask does to the filter: nothing of what it hides takes part, from the first image on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.dataset.camera_file import CameraFile, format_camera_file
from pipelines.dataset.images import encode_png
from pipelines.dataset.importers.placing import format_list
from pipelines.dock.pose_estimate import PoseEstimate
from pipelines.dock.robot import STANDSTILL, Movement
from pipelines.dock.stall_detection import is_stalled, snapshot_of
from pipelines.geometry.camera import Camera, Undistorter
from pipelines.geometry.pose import world_from_base_planar
from pipelines.geometry.trajectory import Trajectory, format_tum
from pipelines.lightfield.scene_file import save_scene
from pipelines.localize.likelihood import likelihood_named
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observer
from pipelines.localize.run import FrameRecord, load_run
from tests.chain_samples import succeed
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo, smooth
from tests.sequence_samples import (
    SCENE,
    TRUTH,
    heading_error,
    localize_sequence,
    mixture_settings,
    position_error,
)

# The lower third shows the robot's own bumper.
BUMPER_TOP = 24
MASK: BoolArray = np.ones((CAMERA.height, CAMERA.width), dtype=np.bool_)
MASK[BUMPER_TOP:] = False
WIDTHS = [12, 24, 48]
WAY = [facing_wall(-1.0 + 0.3 * i, 1.5, 0.1 * i - 0.3) for i in range(7)]
FISHEYE = Camera("OPENCV_FISHEYE", 48, 36, (24.0, 24.0, 23.5, 17.5, 0.02, 0.0, 0.0, 0.0))
RADIAL = Camera("SIMPLE_RADIAL", 48, 36, (24.0, 23.5, 17.5, -0.05))
MILD = Camera("SIMPLE_RADIAL", 48, 36, (24.0, 23.5, 17.5, 0.02))
every_camera = pytest.mark.parametrize(
    "camera", [CAMERA, RADIAL, MILD, FISHEYE], ids=["pinhole", "barrel", "cushion", "fisheye"]
)


def bumper() -> ImageArray:
    """A picture with strong texture: squares of black and bright colours."""
    generator = np.random.default_rng(4)
    squares = generator.choice([0, 255], size=(4, 16, 3)).astype(np.uint8)
    return np.repeat(np.repeat(squares, 3, axis=0), 3, axis=1)


def with_bumper(image: ImageArray) -> ImageArray:
    covered = image.copy()
    covered[BUMPER_TOP:] = bumper()
    return covered


def hidden(observer: Observer, image: ImageArray) -> dict[int, BoolArray]:
    """Width -> pixels that are left out; all channels of a pixel or none."""
    found = {}
    for width, observation in observer(image).by_width.items():
        gaps = np.isnan(observation.image)
        np.testing.assert_array_equal(gaps.any(axis=2), gaps.all(axis=2))
        found[width] = np.asarray(gaps.any(axis=2))
    return found


# --- the observer ------------------------------------------------------------------------------


def test_masked_pixels_are_left_out_of_the_first_image_in_all_widths() -> None:
    for width, gaps in hidden(Observer(CAMERA, WIDTHS, MASK), photo(WAY[0])).items():
        first = BUMPER_TOP * width // CAMERA.width
        np.testing.assert_array_equal(gaps[:first], False)
        np.testing.assert_array_equal(gaps[first:], True)


def test_a_pixel_is_left_out_with_a_hundredth_of_its_area() -> None:
    camera = Camera("SIMPLE_PINHOLE", 480, 360, (240.0, 239.5, 179.5))
    image = np.full((360, 480, 3), 90, dtype=np.uint8)
    mask = np.ones((360, 480), dtype=np.bool_)
    # A pixel at width 24 covers 20 x 20 of the camera's.
    mask[40, 60:64] = False
    assert not hidden(Observer(camera, [24], mask), image)[24].any()
    mask[40, 64] = False
    (gaps,) = hidden(Observer(camera, [24], mask), image).values()
    assert np.argwhere(gaps).tolist() == [[2, 3]]


@every_camera
def test_what_is_masked_changes_nothing_that_remains(camera: Camera) -> None:
    # Else an average or the undistortion would have let some of it through.
    image = photo(WAY[0])
    plain, covered = Observer(camera, WIDTHS, MASK), Observer(camera, WIDTHS, MASK)
    for width, clean in plain(image).by_width.items():
        spoilt = covered(with_bumper(image)).by_width[width]
        # A hundredth of a pixel may be masked: so much of 255 grey levels, and rounding.
        np.testing.assert_allclose(clean.image, spoilt.image, atol=2.55 + 1.0)
        assert np.isfinite(clean.image).any()


@every_camera
def test_the_mask_is_where_the_undistorted_image_shows_the_bumper(camera: Camera) -> None:
    (gaps,) = hidden(Observer(camera, [48], MASK), photo(WAY[0])).values()
    # Where a pixel of the pinhole looks, followed through the distortion by the camera model alone.
    pinhole = Undistorter(camera).intrinsics
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    x, y = (columns - pinhole.cx) / pinhole.fx, (rows - pinhole.cy) / pinhole.fy
    seen = camera.intrinsics.fy * y * _radial_factor(camera, np.hypot(x, y)) + 17.5
    np.testing.assert_array_equal(gaps[seen > BUMPER_TOP + 0.01], True)
    np.testing.assert_array_equal(gaps[seen < BUMPER_TOP - 1.01], False)


def _radial_factor(camera: Camera, radius: FloatArray) -> FloatArray:
    if camera.model == "OPENCV_FISHEYE":
        angle = np.arctan(radius)
        return np.asarray(angle * (1.0 + 0.02 * angle**2) / np.maximum(radius, 1e-12))
    k = camera.params[3] if camera.model == "SIMPLE_RADIAL" else 0.0
    return np.asarray(1.0 + k * radius**2)


def test_the_contrast_is_that_of_the_used_pixels() -> None:
    # A covered lens behind a gaudy bumper is blind.
    observer = Observer(CAMERA, WIDTHS, MASK)
    dark = with_bumper(np.full((CAMERA.height, CAMERA.width, 3), 20, dtype=np.uint8))
    assert not Observer(CAMERA, WIDTHS)(dark).is_blind
    assert observer(dark).is_blind
    seen = observer(with_bumper(photo(WAY[0])))
    used = seen.by_width[12].image[: BUMPER_TOP * 12 // 48]
    assert seen.contrast == pytest.approx(used.mean(axis=2).std(), rel=1e-6)


def test_what_is_masked_is_not_discovered_and_what_is_not_masked_still_is() -> None:
    observer = Observer(CAMERA, WIDTHS, MASK)
    assert not any(observer(with_bumper(photo(state))).is_newly_masked for state in WAY)
    # Tape on the part that is used.
    observer = Observer(CAMERA, WIDTHS, MASK)
    uncovered = []
    for state in WAY:
        image = with_bumper(photo(state))
        image[:16, :16] = (120, 110, 90)
        observations = observer(image)
        uncovered.append(observations.is_newly_masked)
    assert uncovered.count(True) == 1
    gaps = np.isnan(observations.by_width[24].image[..., 0])
    assert gaps[12:].all()
    assert gaps[:7, :7].all()
    assert not gaps[:12, 10:].any()


def test_a_mask_over_most_of_the_image_does_not_keep_tape_from_being_found() -> None:
    # Of all pixels more than half are masked: the usual pixel is one of those that are used.
    mask = np.zeros_like(MASK)
    mask[:, 28:] = True
    observer = Observer(CAMERA, [24], mask)
    for state in WAY:
        image = photo(state)
        image[:, :28] = 77
        image[:18, 28:36] = (120, 110, 90)
        observations = observer(image)
    gaps = np.isnan(observations.by_width[24].image[..., 0])
    assert gaps[:8, 14:17].all()
    assert not gaps[10:, 15:].any()


def test_no_mask_and_one_that_uses_everything_are_the_same() -> None:
    plain, masked = Observer(CAMERA, WIDTHS), Observer(CAMERA, WIDTHS, np.ones_like(MASK))
    for state in WAY:
        first, second = plain(photo(state)), masked(photo(state))
        assert first.contrast == second.contrast
        for width in WIDTHS:
            np.testing.assert_array_equal(first.by_width[width].image, second.by_width[width].image)


@pytest.mark.parametrize("shape", [(36, 47), (48, 36), (36, 48, 3), (36,)])
def test_a_mask_of_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    mask = np.ones(shape, dtype=np.bool_)
    with pytest.raises(OptionError, match=r"mask has the shape .*\(36, 48\)"):
        Observer(CAMERA, [24], mask)
    with pytest.raises(OptionError, match="mask has the shape"):
        Localizer(SCENE, CAMERA, MOUNT, mixture_settings(), np.random.default_rng(0), mask=mask)


def test_a_mask_that_leaves_nothing_of_the_small_image_is_refused() -> None:
    # Half of the pixels are used, but none of the averages is free of the others.
    mask = np.indices(MASK.shape).sum(axis=0) % 2 == 0
    with pytest.raises(OptionError, match=r"leaves 0\.0% of the undistorted image at 24 pixels"):
        Observer(CAMERA, [24], mask)
    # An undistorted image shows less than the camera's corners.
    corner = np.zeros_like(MASK)
    corner[:8, :12] = True
    strong = replace(FISHEYE, params=(14.0, 14.0, 23.5, 17.5, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(OptionError, match="of the undistorted image"):
        Observer(strong, [24], corner)


def test_the_mask_stays_as_it_was() -> None:
    mask = MASK.copy()
    Observer(CAMERA, WIDTHS, mask)(photo(WAY[0]))
    np.testing.assert_array_equal(mask, MASK)


# --- the filter --------------------------------------------------------------------------------

# The left third shows a board on the robot with a picture of another part of the wall.
BOARD_MASK: BoolArray = np.ones((CAMERA.height, CAMERA.width), dtype=np.bool_)
BOARD_MASK[:, :16] = False
BOARD = photo(facing_wall(1.2, 1.6, -0.3))[:, :16]


def driven(mask: BoolArray | None, seed: int, likelihood: str) -> list[FrameRecord]:
    """The records of a sequence with the board in every image."""
    images = [photo(state) for state in TRUTH]
    for image in images:
        image[:, :16] = BOARD
    rng = np.random.default_rng(seed)
    chosen = mixture_settings(likelihood=likelihood_named(likelihood))
    robot = Localizer(SCENE, CAMERA, MOUNT, chosen, rng, mask=mask)
    return localize_sequence(robot, images=images)


@pytest.mark.parametrize("seed", range(2))
def test_a_board_over_a_third_of_every_image_does_no_harm_from_the_first_frame_on(
    seed: int,
) -> None:
    records = driven(BOARD_MASK, seed, "evidence")
    # Two thirds of one image are worth less than a whole one, and may not be enough alone.
    assert records[0].status in ("tracking", "global")
    assert position_error(records[0], TRUTH[0]) < 0.1
    first = 0 if records[0].status == "tracking" else 1
    for record, state in zip(records[first:], TRUTH[first:], strict=True):
        assert record.status == "tracking"
        assert position_error(record, state, "refined") < 0.03
        assert heading_error(record, state, "refined") < np.radians(1.0)


@pytest.mark.parametrize("seed", range(2))
def test_without_the_mask_squared_differences_do_not_find_the_robot_at_once(
    seed: int,
) -> None:
    first = driven(None, seed, "squared")[0]
    assert first.status != "tracking" or position_error(first, TRUTH[0]) > 0.2
    # With the mask the same images find it.
    masked = driven(BOARD_MASK, seed, "squared")[0]
    assert masked.status == "tracking"
    assert position_error(masked, TRUTH[0]) < 0.1


def test_the_board_says_nothing_for_the_map_where_it_is_masked() -> None:
    model = MeasurementModel.of_scene(SCENE, MOUNT, mixture_settings())
    plain, covered = photo(TRUTH[0]), photo(TRUTH[0])
    covered[:, :16] = BOARD
    found = [
        float(model.evidence(TRUTH[:1], Observer(CAMERA, [48], mask)(image).by_width[48])[0])
        for mask, image in ((None, plain), (BOARD_MASK, plain), (BOARD_MASK, covered))
    ]
    # Two thirds of the image are there; they say what they say, whatever the board shows.
    assert found[0] > found[1] > 0.5 * found[0]
    assert found[2] == pytest.approx(found[1], rel=1e-6)
    bare = float(model.evidence(TRUTH[:1], Observer(CAMERA, [48])(covered).by_width[48])[0])
    assert bare < found[1]


def test_a_board_does_not_make_a_robot_that_drives_seem_to_stand() -> None:
    mask = np.ones_like(MASK)
    mask[:, :36] = False
    checks = 255 * (np.indices((CAMERA.height, 36)).sum(axis=0) // 6 % 2)
    images = [photo(state, paint=smooth) for state in (TRUTH[0], TRUTH[3])]
    for image in images:
        image[:, :36] = checks[..., None]
    nowhere = np.empty((0, 4))
    estimate = PoseEstimate(
        TRUTH[0], np.eye(3), nowhere, is_refined=False, is_localized=False, is_blind=False
    )
    step = Movement(0.4, 0.0, 0.0)
    for used, stood in ((None, True), (mask, False)):
        before, after = (snapshot_of(image, estimate, used) for image in images)
        # Odometry, too, says that nothing moved: the images decide.
        assert is_stalled(step, STANDSTILL, before, after) is stood


def test_the_command_uses_the_masks_of_data_set_and_option(tmp_path: Path) -> None:
    scene = tmp_path / "scene.h5"
    save_scene(scene, SCENE, overwrite=False)
    data = tmp_path / "drive"
    data.mkdir()
    for number, state in enumerate(TRUTH):
        image = photo(state)
        image[:, :16] = BOARD
        (data / f"{number}.png").write_bytes(encode_png(image))
    times = np.arange(float(len(TRUTH)))
    names = [f"{number}.png" for number in range(len(TRUTH))]
    (data / "rgb.txt").write_text(format_list(times.tolist(), names), encoding="utf-8")
    (data / "odometry.txt").write_text(
        format_tum(Trajectory(times, world_from_base_planar(TRUTH))), encoding="utf-8"
    )
    (data / "camera.toml").write_text(
        format_camera_file(CameraFile(CAMERA, MOUNT, None)), encoding="utf-8"
    )
    (data / "mask.png").write_bytes(encode_png(np.where(BOARD_MASK, 255, 0).astype(np.uint8)))
    given = tmp_path / "given.png"
    given.write_bytes(encode_png(np.full(BOARD_MASK.shape, 255, dtype=np.uint8)))
    assert "33 % of the image left out" in succeed("info", data)

    small = (
        "--particles",
        "60",
        "--start-particles",
        "2000",
        "--fine-width",
        "24",
        "--refine-width",
    )
    command = ("localize", scene, data, *small, "48", "--threads", "1", "-o")
    for name, options, mask in (
        ("own", (), data / "mask.png"),
        ("given", ("--mask", given), given),
    ):
        succeed(*command, tmp_path / f"{name}.h5", *options)
        run = load_run(tmp_path / f"{name}.h5")
        assert run.provenance["inputs"]["mask"] == sha256_of_file(mask)
        assert [frame.status for frame in run.frames[1:]] == ["tracking"] * (len(TRUTH) - 1)
        assert position_error(run.frames[1], TRUTH[1], "refined") < 0.03
    (data / "mask.png").unlink()
    succeed(*command, tmp_path / "none.h5")
    none, given_run = load_run(tmp_path / "none.h5"), load_run(tmp_path / "given.h5")
    assert "mask" not in none.provenance["inputs"]
    np.testing.assert_array_equal(none.frames[-1].particles, given_run.frames[-1].particles)
    own = load_run(tmp_path / "own.h5")
    assert not np.array_equal(own.frames[-1].particles, given_run.frames[-1].particles)
