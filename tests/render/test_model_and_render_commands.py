"""``lfnav model`` and ``lfnav render`` on the sample data, from the command line."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.arrays import BoolArray, ImageArray
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.dataset import load_dataset
from pipelines.dataset.images import decode_image
from pipelines.dataset.pairing import poses_at_images
from pipelines.geometry.plane import angle_between
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene, scene_provenance
from pipelines.lightfield.views import area_average
from pipelines.render.choices import Blending
from pipelines.render.renderer import Renderer, Rendering
from pipelines.render.stage import RenderSettings, render, virtual_intrinsics
from tests.lightfield_samples import WALL

SAMPLES = Path(__file__).parents[2] / "sample_data" / "elevators"
POSE = "-1.2,-2.0,90"


def lfnav(*arguments: str | Path) -> int:
    return common.run_command(main, [str(argument) for argument in arguments])


def fails(capsys: pytest.CaptureFixture[str], *arguments: str | Path, code: int = 1) -> str:
    """The one line that a failing command says."""
    capsys.readouterr()
    assert lfnav(*arguments) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("lfnav: ")
    assert captured.err.count("\n") == 1
    return captured.err


@pytest.fixture(scope="module")
def reconstruction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of photos that lie beside it and are nobody else's."""
    folder = tmp_path_factory.mktemp("elevators")
    shutil.copytree(SAMPLES / "map", folder / "map")
    target = folder / "reconstruction"
    assert (
        lfnav("reconstruct", folder / "map", "-o", target, "--method", "odometry", "--quiet") == 0
    )
    return target


@pytest.fixture(scope="module")
def scene_path(reconstruction: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the plane given."""
    target = tmp_path_factory.mktemp("scene") / "scene.h5"
    assert lfnav("model", reconstruction, "-o", target, "--plane", "0,1,0,0", "--quiet") == 0
    return target


@pytest.fixture
def copied(reconstruction: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A reconstruction and the folder of its photos, to be spoiled."""
    photos = tmp_path / "photos"
    shutil.copytree(reconstruction.parent / "map", photos)
    shutil.copytree(reconstruction, tmp_path / "reconstruction")
    return tmp_path / "reconstruction", photos


def png(path: Path) -> ImageArray:
    return decode_image(path.read_bytes(), path)


def mask(path: Path) -> BoolArray:
    """A mask is black or white, nothing between."""
    image = png(path)
    assert set(np.unique(image)) <= {0, 255}
    return np.asarray(image[..., 0] == 255)


def rendered(scene_path: Path, states: list[tuple[float, float, float]]) -> list[Rendering]:
    """What the library renders at x, y, heading in degrees."""
    scene = load_scene(scene_path)
    renderer = Renderer.of_scene(scene, threads=1)
    assert scene.base_from_camera is not None
    poses = world_from_base_planar([(x, y, np.radians(a)) for x, y, a in states])
    intrinsics = virtual_intrinsics(scene, 96)
    return [renderer.render(pose @ scene.base_from_camera, intrinsics) for pose in poses]


def tum(path: Path, states: list[tuple[float, float, float]]) -> Path:
    rows = [
        f"{time} {x} {y} 0 0 0 {np.sin(np.radians(a) / 2):.12f} {np.cos(np.radians(a) / 2):.12f}"
        for time, (x, y, a) in enumerate(states)
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


# --- model -------------------------------------------------------------------------------------


def test_model_with_a_given_plane(
    reconstruction: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "new folder" / "scene.h5"
    # Any multiple of the equation, whichever way it faces.
    assert lfnav("model", reconstruction, "-o", target, "--plane", "0,2,0,0.5", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    scene = load_scene(target)
    assert scene.surface is not None
    np.testing.assert_allclose(scene.plane.coefficients(), [0.0, -1.0, 0.0, -0.25])
    assert facts["plane"]["method"] == scene.surface.method == "given"
    assert facts["views"] == len(scene) == len(list((SAMPLES / "map" / "rgb").iterdir()))
    assert facts["has_mount"]
    assert facts["scale_source"] == "odometry"
    for name, data in zip(scene.image_names, scene.encoded_images, strict=True):
        assert data == (SAMPLES / "map" / name).read_bytes()
    record = scene_provenance(target)
    assert record["settings"]["plane"] == [0.0, 2.0, 0.0, 0.5]
    assert str(tmp_path) not in json.dumps(record)


def test_model_in_compact_storage(
    reconstruction: Path, scene_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "compact.h5"
    options = ("--plane", "0,1,0,0", "--storage", "compact", "--json")
    assert lfnav("model", reconstruction, "-o", target, *options) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["storage"]["kind"] == "compact"
    assert facts["storage"]["photo_psnr_db"] > 35.0
    assert target.stat().st_size < 0.15 * scene_path.stat().st_size
    assert scene_provenance(target)["settings"]["storage"] == "compact"
    assert lfnav("info", target) == 0
    assert "compact: " in capsys.readouterr().out
    # Whatever works with a scene works with this one.
    assert lfnav("evaluate", target, "--dataset", SAMPLES / "test", "--json") == 0
    compact = json.loads(capsys.readouterr().out)
    assert lfnav("evaluate", scene_path, "--dataset", SAMPLES / "test", "--json") == 0
    full = json.loads(capsys.readouterr().out)
    assert compact["psnr_db"]["mean"] > full["psnr_db"]["mean"] - 0.5


def test_model_is_the_same_again(reconstruction: Path, scene_path: Path, tmp_path: Path) -> None:
    target = tmp_path / "again.h5"
    assert lfnav("model", reconstruction, "-o", target, "--plane", "0,1,0,0", "--quiet") == 0
    assert target.read_bytes() == scene_path.read_bytes()


def test_a_photo_that_changed_since_the_reconstruction(
    copied: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reconstruction, photos = copied
    target = tmp_path / "s.h5"
    plane = ("--plane", "0,1,0,0", "--quiet")
    arguments = ("model", reconstruction, "-o", target, "--images", photos, *plane)
    assert lfnav(*arguments) == 0
    (tmp_path / "s.h5").unlink()
    name = load_dataset(photos).image_names[5]
    shutil.copy(photos / load_dataset(photos).image_names[6], photos / name)
    text = fails(capsys, *arguments)
    assert name in text
    assert "not the photo that was reconstructed" in text
    assert "--images" in text
    assert not (tmp_path / "s.h5").exists()


def test_photos_that_are_gone(
    copied: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reconstruction, photos = copied
    name = load_dataset(photos).image_names[3]
    (photos / name).unlink()
    text = fails(
        capsys, "model", reconstruction, "-o", tmp_path / "s.h5", "--images", photos,
        "--plane", "0,1,0,0",
    )  # fmt: skip
    assert name in text
    text = fails(capsys, "model", reconstruction, "-o", tmp_path / "s.h5", "--images", "nowhere")
    assert "nowhere" in text
    assert not (tmp_path / "s.h5").exists()


def test_model_refuses_what_it_cannot_do(
    reconstruction: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "s.h5"
    model = ("model", reconstruction, "-o", target)
    for plane in ("0,1,0", "0,1,0,x", "0,1,0,nan", "0,1,0,inf", "0,1,0,0,0", ""):
        assert "A,B,C,D" in fails(capsys, *model, "--plane", plane, code=2)
    assert "zero" in fails(capsys, *model, "--plane", "0,0,0,1")
    fails(capsys, *model, "--geometry", "sphere", code=2)
    assert "no-such" in fails(capsys, "model", tmp_path / "no-such", "-o", target)
    assert list(tmp_path.iterdir()) == []


def test_existing_scene_is_kept_without_overwrite(
    reconstruction: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "s.h5"
    target.write_text("mine")
    model = ("model", reconstruction, "-o", target, "--plane", "0,1,0,0", "--quiet")
    assert "--overwrite" in fails(capsys, *model)
    assert target.read_text() == "mine"
    assert lfnav(*model, "--overwrite") == 0
    assert len(load_scene(target)) > 20


# --- render ------------------------------------------------------------------------------------


def test_render_one_pose_as_png(
    scene_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "view.png"
    arguments = ("render", scene_path, "-o", target, "--pose", POSE, "--width", "96")
    assert lfnav(*arguments, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["width"], facts["height"]) == (96, 72)
    (expected,) = rendered(scene_path, [(-1.2, -2.0, 90.0)])
    np.testing.assert_array_equal(png(target), expected.image)
    np.testing.assert_array_equal(mask(tmp_path / "view_mask.png"), expected.covered)
    assert facts["coverage"] == [pytest.approx(expected.coverage)]
    assert expected.coverage > 0.5
    # The pose means what it says: turned to the right, what was in the middle moves to the left.
    assert lfnav(*arguments[:4], "--pose", "-1.2,-2.0,80", "--width", "96", "--overwrite") == 0
    turned = png(target).astype(float)
    shift = round(577.3 / 640 * 96 * np.tan(np.radians(10.0)))
    middle = expected.image[20:50, 40:60].astype(float)
    moved = turned[20:50, 40 - shift : 60 - shift]
    still = turned[20:50, 40:60]
    assert np.abs(moved - middle).mean() < 0.5 * np.abs(still - middle).mean()


def test_render_a_folder_of_poses(scene_path: Path, tmp_path: Path) -> None:
    states = [(-1.2, -2.0, 90.0), (0.5, -1.5, 60.0), (0.5, -1.5, -90.0)]
    poses = tum(tmp_path / "poses.txt", states)
    target = tmp_path / "views"
    arguments = ("render", scene_path, "-o", target, "--poses", poses, "--width", "96", "--quiet")
    assert lfnav(*arguments) == 0
    expected = rendered(scene_path, states)
    for number, rendering in enumerate(expected):
        # The quaternions have twelve digits.
        difference = png(target / f"{number:06d}.png").astype(int) - rendering.image
        assert np.abs(difference).max() <= 1
        covered = mask(target / f"{number:06d}_mask.png")
        np.testing.assert_array_equal(covered, rendering.covered)
        assert not png(target / f"{number:06d}.png")[~covered].any()
    assert not expected[2].covered.any()
    listing = (target / "views.txt").read_text().splitlines()[1:]
    assert [line.split()[0] for line in listing] == [f"{i:06d}.png" for i in range(3)]
    for line, rendering in zip(listing, expected, strict=True):
        assert float(line.split()[2]) == pytest.approx(rendering.coverage, abs=1e-4)
    assert len(list(target.iterdir())) == 7
    # Fewer views replace all of the old ones.
    tum(poses, states[:1])
    assert lfnav(*arguments, "--overwrite") == 0
    assert len(list(target.iterdir())) == 3


def frames(path: Path) -> list[ImageArray]:
    video = cv2.VideoCapture(str(path))
    found: list[ImageArray] = []
    while True:
        more, image = video.read()
        if not more:
            return found
        found.append(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8))


def test_render_a_video(scene_path: Path, tmp_path: Path) -> None:
    states = [(-1.2 + 0.2 * step, -2.0, 90.0 - 8.0 * step) for step in range(4)]
    poses = tum(tmp_path / "poses.txt", states)
    target = tmp_path / "video.mp4"
    arguments = ("render", scene_path, "-o", target, "--poses", poses, "--width", "96", "--quiet")
    assert lfnav(*arguments, "--fps", "5") == 0
    expected = rendered(scene_path, states)
    images, masks = frames(target), frames(tmp_path / "video_mask.mp4")
    assert len(images) == len(masks) == 4
    for image, covered, rendering in zip(images, masks, expected, strict=True):
        assert np.abs(image.astype(float) - rendering.image).mean() < 8.0
        assert np.mean((covered[..., 0] > 127) == rendering.covered) > 0.98
    video = cv2.VideoCapture(str(target))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(5.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "poses.txt",
        "video.mp4",
        "video_mask.mp4",
    ]


@pytest.mark.parametrize("name", ["video.mp4", "views"])
def test_interrupted_rendering_leaves_nothing(
    scene_path: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    poses = tum(tmp_path / "poses.txt", [(-1.2, -2.0, 90.0)] * 3)
    real = Renderer.render
    calls = []

    def interrupted(*arguments: object) -> Rendering:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(Renderer, "render", interrupted)
    with pytest.raises(KeyboardInterrupt):
        render(
            scene_path,
            tmp_path / name,
            RenderSettings(poses=poses, width=64),
            overwrite=False,
            progress=no_progress,
        )
    assert [path.name for path in tmp_path.iterdir()] == ["poses.txt"]


def test_render_refuses_what_it_cannot_do(
    scene_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = tum(tmp_path / "poses.txt", [(-1.2, -2.0, 90.0)] * 2)
    start = ("render", scene_path, "-o", tmp_path / "v.png")
    both = "either --pose or --poses"
    assert both in fails(capsys, *start, "--pose", POSE, "--poses", poses, code=2)
    assert both in fails(capsys, *start, code=2)
    assert "X,Y,HEADING_DEG" in fails(capsys, *start, "--pose", "1,2", code=2)
    assert "name a folder" in fails(capsys, *start, "--poses", poses)
    for width in ("0", "-5", "100000"):
        assert f"width {width}" in fails(capsys, *start, "--pose", POSE, "--width", width)
    assert "frames a second" in fails(capsys, *start, "--pose", POSE, "--fps", "0")
    assert "nothing.txt" in fails(capsys, *start, "--poses", tmp_path / "nothing.txt")
    (tmp_path / "bad.txt").write_text("0 1 2\n")
    assert "bad.txt" in fails(capsys, *start, "--poses", tmp_path / "bad.txt")
    (tmp_path / "text.h5").write_text("no scene")
    assert "text.h5" in fails(
        capsys, "render", tmp_path / "text.h5", "-o", tmp_path / "v.png", "--pose", POSE
    )
    names = {"poses.txt", "bad.txt", "text.h5"}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_existing_views_are_kept_without_overwrite(
    scene_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pose = ("--pose", POSE, "--width", "32", "--quiet")
    for name in ("v.png", "v_mask.png", "m.mp4", "m_mask.mp4"):
        (tmp_path / name).write_text("mine")
        output = tmp_path / name.replace("_mask", "")
        assert "--overwrite" in fails(capsys, "render", scene_path, "-o", output, *pose)
        assert (tmp_path / name).read_text() == "mine"
        assert len(list(tmp_path.iterdir())) == 1
        (tmp_path / name).unlink()
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.txt").write_text("mine")
    render_folder = ("render", scene_path, "-o", folder, *pose)
    assert "--overwrite" in fails(capsys, *render_folder)
    # Not even then: lfnav did not make this folder.
    assert "did not make it" in fails(capsys, *render_folder, "--overwrite")
    assert (folder / "chapter1.txt").read_text() == "mine"


# --- how good the views are --------------------------------------------------------------------


@pytest.fixture(scope="module")
def estimated(reconstruction: Path, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """The map by odometry alone, the plane from its photos."""
    target = tmp_path_factory.mktemp("estimated") / "scene.h5"
    assert lfnav("model", reconstruction, "-o", target, "--quiet") == 0
    return load_scene(target)


def mean_psnr(scene: Scene, width: int) -> float:
    """Of views at the true poses of the test drive, each after one gain, where covered."""
    data = load_dataset(SAMPLES / "test")
    assert data.groundtruth is not None
    source = SAMPLES / "test" / "groundtruth.txt"
    poses = poses_at_images(data, data.groundtruth, source) @ data.body_from_camera
    renderer = Renderer.of_scene(scene, blending=Blending.UNSTRUCTURED)
    intrinsics = virtual_intrinsics(scene, width)
    figures = []
    for index, pose in enumerate(poses):
        rendering = renderer.render(pose, intrinsics)
        assert rendering.coverage > 0.5
        photo = area_average(data.read_image(index), intrinsics.width, intrinsics.height)
        view = rendering.image[rendering.covered].astype(np.float64)
        taken = photo[rendering.covered].astype(np.float64)
        gain = float(np.sum(view * taken) / np.sum(view * view))
        figures.append(10.0 * np.log10(255.0**2 / np.mean((gain * view - taken) ** 2)))
    return float(np.mean(figures))


def test_the_plane_of_the_sample_data_is_found(estimated: Scene) -> None:
    """The bound that the project promises: 8 cm and 1.5 degrees of y = 0, over the wall."""
    assert estimated.surface is not None
    assert estimated.surface.method == "photos"
    assert angle_between(estimated.plane, WALL) < np.radians(1.5)
    for x in (-2.5, -1.2, 0.0):
        assert abs(float(estimated.plane.signed_distance([x, 0.0, 1.0]))) < 0.08
    assert 0.005 < estimated.surface.offset_sigma < 0.1
    assert np.radians(0.1) < estimated.surface.angle_sigma < np.radians(3.0)


def test_views_at_the_true_poses_reduced(estimated: Scene) -> None:
    """At the size at which photos are compared: 22.5 dB when this was written."""
    assert mean_psnr(estimated, 160) >= 22.0


def test_views_at_the_true_poses_as_recorded(estimated: Scene) -> None:
    """The bound that the project promises, at full resolution."""
    assert mean_psnr(estimated, 640) >= 22.0
