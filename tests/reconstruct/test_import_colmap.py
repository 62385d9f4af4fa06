"""COLMAP models as COLMAP writes them, and models whose photos are gone or that lie."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfnav_cli.common import run_command
from lfnav_cli.main import main
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.pose import inverse
from pipelines.reconstruct.colmap_model import read_model, write_model
from pipelines.reconstruct.colmap_text import read_any_model
from pipelines.reconstruct.import_description import ImportSummary
from pipelines.reconstruct.import_stage import import_source
from pipelines.reconstruct.reconstruction import load_reconstruction
from tests.import_samples import SHARED, project, refusal, run_pycolmap, write_picture

# Three images, two cameras, five points, written by COLMAP itself, with what it projects them to.
WRITE_MODEL = """
import json, os, sys
import numpy as np, pycolmap
rec = pycolmap.Reconstruction()
for number, focal in ((1, 40.0), (2, 30.0)):
    rec.add_camera_with_trivial_rig(pycolmap.Camera(
        camera_id=number, model="PINHOLE", width=32, height=24,
        params=[focal, focal + 1, 16.0, 12.5]))
points = np.array([[0.0, 0, 4], [0.5, 0.2, 5], [-0.4, 0.3, 6], [0.2, -0.5, 4.5], [0.1, 0.4, 7]])
names = {1: "b/10.png", 2: "b/9.png", 3: "a b.png"}
pixels = {}
for number, name in names.items():
    turn = pycolmap.Rotation3d(np.array([0.0, 0.05 * number, 0.0, 1.0]))
    turn.normalize()
    pose = pycolmap.Rigid3d(turn, np.array([0.1 * number, 0.02, 0.0]))
    camera = rec.cameras[1 if number < 3 else 2]
    seen = [camera.img_from_cam(pose * point) for point in points]
    image = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=number,
        points2D=pycolmap.Point2DList([pycolmap.Point2D(np.array(p).ravel()) for p in seen]))
    rec.add_image_with_trivial_frame(image, pose)
    pixels[name] = [np.array(p).ravel().tolist() for p in seen]
for index, point in enumerate(points):
    track = pycolmap.Track()
    for number in names:
        track.add_element(number, index)
    rec.add_point3D(point, track, np.array([10, 20, 30 + index], dtype=np.uint8))
for folder, write in ((sys.argv[1], rec.write_text), (sys.argv[2], rec.write_binary)):
    os.makedirs(folder)
    write(folder)
print(json.dumps([points.tolist(), pixels]))
"""


@pytest.fixture(scope="module")
def project_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``text/`` and ``binary/``, projects of the same model; ``truth.json`` beside them."""
    root = tmp_path_factory.mktemp("colmap")
    truth = run_pycolmap(WRITE_MODEL, root / "text" / "sparse" / "0", root / "binary" / "sparse")
    (root / "truth.json").write_text(truth)
    for form in ("text", "binary"):
        for number, name in enumerate(("b/10.png", "b/9.png", "a b.png")):
            write_picture(root / form / "images" / name, number)
    return root


def imported(source: Path, output: Path, **options: object) -> ImportSummary:
    settings = ImportSettings(**options)  # type: ignore[arg-type]
    return import_source(source, output, settings, overwrite=False, progress=no_progress)


@pytest.mark.parametrize("form", ["text", "binary"])
def test_points_land_where_colmap_projects_them(
    project_folder: Path, tmp_path: Path, form: str
) -> None:
    points, pixels = json.loads((project_folder / "truth.json").read_text())
    summary = imported(project_folder / form, tmp_path / "out")
    content = load_reconstruction(tmp_path / "out" / "reconstruction")
    assert summary.kind == "colmap"
    assert content.image_names == ("rgb/a b.png", "rgb/b/9.png", "rgb/b/10.png")
    for row, name in enumerate(content.image_names):
        camera = content.cameras[content.camera_index[row]]
        for index, point in enumerate(points):
            found = project(camera, content.world_from_camera[row], np.array(point))
            expected = np.array(pixels[name.removeprefix("rgb/")][index]) - 0.5
            np.testing.assert_allclose(found, expected, atol=1e-9)
    # The tracks came along, and what they observe is what COLMAP projected.
    assert len(content.observations) == 15
    for (point, image), pixel in zip(content.observations, content.observed_pixels, strict=True):
        position = content.points[point]
        camera = content.cameras[content.camera_index[image]]
        found = project(camera, content.world_from_camera[image], position)
        np.testing.assert_allclose(found, pixel, atol=1e-9)
    order = np.argsort(content.point_colors[:, 2])
    np.testing.assert_allclose(content.points[order], points)
    source = project_folder / form / "images" / "b" / "9.png"
    assert (tmp_path / "out" / "rgb" / "b" / "9.png").read_bytes() == source.read_bytes()


def test_text_and_binary_are_the_same_model(project_folder: Path) -> None:
    text = read_any_model(project_folder / "text" / "sparse" / "0")
    binary = read_model(project_folder / "binary" / "sparse")
    assert text.cameras == binary.cameras
    theirs = {image.identifier: image for image in binary.images}
    for image in text.images:
        other = theirs[image.identifier]
        assert image.name == other.name
        np.testing.assert_allclose(image.camera_from_world, other.camera_from_world, atol=1e-12)
        np.testing.assert_allclose(image.keypoints, other.keypoints, atol=1e-9)
        np.testing.assert_array_equal(image.points, other.points)


def test_scale_and_upright_keep_every_projection(project_folder: Path, tmp_path: Path) -> None:
    source = project_folder / "text"
    assert any("--upright" in note for note in imported(source, tmp_path / "as_is").notes)
    imported(source, tmp_path / "up", upright=True, scale=3.0)
    content = load_reconstruction(tmp_path / "up" / "reconstruction")
    assert content.scale_source == "--scale"
    # The first image is the origin and looks along x; the cameras stand upright.
    np.testing.assert_allclose(content.world_from_camera[0, :3, 3], 0.0, atol=1e-9)
    assert content.world_from_camera[0, 1, 2] == pytest.approx(0.0, abs=1e-9)
    assert -content.world_from_camera[:, 2, 1].mean() > 0.99
    original = load_reconstruction(tmp_path / "as_is" / "reconstruction")
    for one, other in ((0, 1), (0, 2)):
        lengths = [
            np.linalg.norm(poses[one, :3, 3] - poses[other, :3, 3])
            for poses in (content.world_from_camera, original.world_from_camera)
        ]
        assert lengths[0] == pytest.approx(3.0 * lengths[1])
    for (point, image), pixel in zip(content.observations, content.observed_pixels, strict=True):
        camera = content.cameras[content.camera_index[image]]
        found = project(camera, content.world_from_camera[image], content.points[point])
        np.testing.assert_allclose(found, pixel, atol=1e-9)


def test_photos_elsewhere_and_the_model_folder_itself(project_folder: Path, tmp_path: Path) -> None:
    model = project_folder / "text" / "sparse" / "0"
    photos = project_folder / "binary" / "images"
    assert imported(model, tmp_path / "a").images == 3  # finds images/ two folders above
    assert imported(model, tmp_path / "b", images=photos).images == 3


def test_links_are_the_same_files(project_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(project_folder / "text", tmp_path / "source")
    imported(tmp_path / "source", tmp_path / "out", link=True)
    linked = tmp_path / "out" / "rgb" / "a b.png"
    assert linked.samefile(tmp_path / "source" / "images" / "a b.png")
    imported(tmp_path / "source", tmp_path / "copy")
    assert not (tmp_path / "copy" / "rgb" / "a b.png").samefile(linked)


def test_photos_that_are_gone(
    project_folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "source"
    shutil.copytree(project_folder / "binary", source)
    (source / "images" / "b" / "10.png").unlink()
    (source / "images" / "b" / "9.png").unlink()
    error = refusal([str(source)], tmp_path / "out", capfd)
    assert "images/b/10.png: is not there" in error
    assert "2 of 3" in error
    assert "--images" in error
    assert "--allow-missing" in error
    shutil.rmtree(source / "images")
    assert "--images" in refusal([str(source)], tmp_path / "out", capfd)
    arguments = [str(source), "--images", str(tmp_path / "nowhere")]
    assert "nowhere: does not exist" in refusal(arguments, tmp_path / "out", capfd)


def test_some_photos_that_are_gone_are_left_out(project_folder: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    shutil.copytree(project_folder / "binary", source)
    (source / "images" / "b" / "10.png").unlink()
    with pytest.raises(InputError, match="1 of 3 photos are missing"):
        imported(source, tmp_path / "out", allow_missing=0.3)
    summary = imported(source, tmp_path / "out", allow_missing=0.4)
    assert summary.images == 2
    assert "1 of 3 photos are not there and left out: 'b/10.png'" in summary.notes
    whole = tmp_path / "whole"
    imported(project_folder / "binary", whole)
    expected = load_reconstruction(whole / "reconstruction")
    found = load_reconstruction(tmp_path / "out" / "reconstruction")
    # The others are what they were, and the points are seen by them alone.
    assert found.image_names == expected.image_names[:2]
    np.testing.assert_array_equal(found.world_from_camera, expected.world_from_camera[:2])
    assert len(found.observations) == 10
    for (point, image), pixel in zip(found.observations, found.observed_pixels, strict=True):
        camera = found.cameras[found.camera_index[image]]
        pose = found.world_from_camera[image]
        np.testing.assert_allclose(project(camera, pose, found.points[point]), pixel, atol=1e-9)
    with pytest.raises(OptionError, match="no share"):
        imported(source, tmp_path / "more", allow_missing=1.5)


def test_all_photos_gone_is_an_error_whatever_is_allowed(
    project_folder: Path, tmp_path: Path
) -> None:
    source = tmp_path / "source"
    shutil.copytree(project_folder / "binary", source)
    for path in list(source.rglob("*.png")):
        path.unlink()
    with pytest.raises(InputError, match="3 of 3 photos are missing"):
        imported(source, tmp_path / "out", allow_missing=1.0)


def many_photos(folder: Path, count: int) -> list[str]:
    """``images/`` with so many photos, and the lines of ``images.txt`` for them."""
    lines = []
    for number in range(count):
        write_picture(folder / "images" / f"{number:04d}.png", number)
        lines.append(f"{number + 1} 1 0 0 0 {-number} 0 0 1 {number:04d}.png\n\n")
    return lines


def write_text_model(folder: Path, lines: list[str], camera: str = "") -> None:
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text(f"# Camera list\n{camera or CAMERA}\n")
    (folder / "images.txt").write_text("# Image list\n" + "".join(lines))
    (folder / "points3D.txt").write_text("# 3D point list\n")


def test_one_photo_of_many_needs_no_option(tmp_path: Path) -> None:
    lines = many_photos(tmp_path / "source", 11)
    write_text_model(tmp_path / "source" / "sparse" / "0", lines)
    (tmp_path / "source" / "images" / "0007.png").unlink()
    summary = imported(tmp_path / "source", tmp_path / "out")
    assert summary.images == 10
    assert any("1 of 11 photos" in note for note in summary.notes)
    # Beyond a tenth it is said.
    (tmp_path / "source" / "images" / "0008.png").unlink()
    with pytest.raises(InputError, match=r"0007\.png: is not there, but has a pose \(2 of 11"):
        imported(tmp_path / "source", tmp_path / "again")
    arguments = [
        "import",
        str(tmp_path / "source"),
        "-o",
        str(tmp_path / "last"),
        "--allow-missing",
    ]
    assert run_command(main, arguments) == 0


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize("place", ["sparse", "."])
def test_of_several_models_the_largest_is_taken(tmp_path: Path, form: str, place: str) -> None:
    source = tmp_path / "source"
    lines = many_photos(source, 9)
    models = {"0": lines[:2], "1": lines[2:8], "2": lines[8:], "10": lines[:5]}
    for name, own in models.items():
        folder = source / place / name
        write_text_model(folder, own)
        if form == "binary":
            write_model(folder, read_any_model(folder))
            for path in folder.glob("*.txt"):
                path.unlink()
    summary = imported(source, tmp_path / "out")
    assert summary.images == 6
    assert (
        "model 1 of 4 is taken, the one with the most photos (6); left out: 0 (2), 2 (1), 10 (5)"
        in summary.notes
    )
    # Whoever names one gets it.
    assert imported(source / place / "10", tmp_path / "ten", images=source / "images").images == 5


@pytest.mark.parametrize(
    ("written", "lies"),
    [
        ("b\\9.png", "b/9.png"),
        (".\\b\\9.png", "b/9.png"),
        ("C:\\Users\\me\\project\\images\\b\\9.png", "b/9.png"),
        ("D:/project/images/b/9.png", "b/9.png"),
        ("/home/somebody/project/images/b/9.png", "b/9.png"),
        ("images/b/9.png", "b/9.png"),
        ("{here}/b/9.png", "b/9.png"),
        ("{here}/../images/b/9.png", "b/9.png"),
    ],
)
def test_names_of_another_machine_are_found(
    project_folder: Path, tmp_path: Path, written: str, lies: str
) -> None:
    source = tmp_path / "source"
    shutil.copytree(project_folder / "text", source)
    written = written.replace("{here}", str(source / "images"))
    path = source / "sparse" / "0" / "images.txt"
    text = path.read_text()
    if written.startswith("images/"):
        # As where COLMAP was given the project's folder: all names begin so.
        for name in ("b/10.png", "b/9.png", "a b.png"):
            text = text.replace(f" {name}\n", f" images/{name}\n")
    else:
        text = text.replace(" b/9.png\n", f" {written}\n")
    path.write_text(text)
    imported(source, tmp_path / "out")
    found = load_reconstruction(tmp_path / "out" / "reconstruction")
    folder = "rgb/images" if written.startswith("images/") else "rgb"
    assert found.image_names == tuple(f"{folder}/{n}" for n in ("a b.png", "b/9.png", "b/10.png"))
    stored = (tmp_path / "out" / folder / lies).read_bytes()
    assert stored == (source / "images" / lies).read_bytes()


CAMERA = "1 PINHOLE 32 24 40 41 16 12.5"


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [
        ("cameras.txt", "1 PINHOLE", "1 FOV", "FOV takes 5 params, got 4"),
        ("cameras.txt", "1 PINHOLE", "1 LENS", "model 'LENS', which is not supported"),
        ("cameras.txt", "1 PINHOLE 32", "1 PINHOLE 64", "is 32x24 pixels, its camera 64x24"),
        ("cameras.txt", "1 PINHOLE 32", "1 PINHOLE 9999999", "9999999x24"),
        ("cameras.txt", "1 PINHOLE 32", "1 PINHOLE 0", "not positive"),
        ("cameras.txt", "1 PINHOLE 32 24 40", "1 PINHOLE 32 24", "takes 4 params"),
        ("cameras.txt", "1 PINHOLE 32 24 40", "1 PINHOLE 32 24 nan", "not finite"),
        ("cameras.txt", "2 PINHOLE", "1 PINHOLE", "camera 1 is there twice"),
        ("cameras.txt", "1 PINHOLE 32", "1 PINHOLE x", "not a whole number"),
        ("cameras.txt", "1 PINHOLE 32", "1 PINHOLE " + "9" * 5000, "not a whole number"),
        ("cameras.txt", "2 PINHOLE", "7 PINHOLE", "camera 2, unknown"),
        ("images.txt", "b/9.png", "../9.png", "leads out of the folder"),
        ("images.txt", "b/9.png", "/etc/passwd", "leads out of the folder"),
        ("images.txt", "b/9.png", "b/10.png", "holds the image 'b/10.png' twice"),
        ("images.txt", "\n2 ", "\n1 ", "is there twice"),
        ("images.txt", " 1 b/9.png\n", " 1 b/9.png\n7 ", "x, y, point for each keypoint"),
        ("images.txt", " 1 b/9.png\n", " 1 b/9.png\n1 nan 1 ", "not finite"),
        ("images.txt", " 1 b/9.png\n", " 1 b/9.png\n1 1 " + "9" * 30 + " ", "whole number"),
        ("points3D.txt", "4 0 4", "4 0 400000", "keypoint"),
        ("points3D.txt", " 10 20 30 ", " 10 20 300 ", "out of range"),
        ("points3D.txt", " 10 20 30 ", " 10 20 30 inf ", "not finite"),
        ("points3D.txt", "\n1 ", "\n2 ", "same point twice"),
    ],
)
def test_text_that_lies_is_one_line(
    project_folder: Path,
    tmp_path: Path,
    name: str,
    old: str,
    new: str,
    reason: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    source = tmp_path / "source"
    shutil.copytree(project_folder / "text", source)
    path = source / "sparse" / "0" / name
    text = path.read_text()
    if old == "4 0 4":  # whatever the tracks look like: the last number of the last line
        text = re.sub(r"(\d+)\s*$", "400000", text)
    else:
        assert old in text, text
        text = text.replace(old, new, 1)
    path.write_text(text)
    assert reason in refusal([str(source)], tmp_path / "out", capfd)


def test_a_binary_model_with_an_unknown_camera_model_is_one_line(
    project_folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(project_folder / "binary", tmp_path / "source")
    path = tmp_path / "source" / "sparse" / "cameras.bin"
    data = bytearray(path.read_bytes())
    data[12:16] = (99).to_bytes(4, "little")  # after the count and the camera's number
    path.write_bytes(bytes(data))
    error = refusal([str(tmp_path / "source")], tmp_path / "out", capfd)
    assert "has model number 99" in error


# Models that OPENCV_FISHEYE or PINHOLE describe exactly, and others.
PINHOLE_PARAMS = "30 31 16 12.5"
EXACT = {
    "SIMPLE_RADIAL_FISHEYE": "30 16 12.5 0.05",
    "RADIAL_FISHEYE": "30 16 12.5 0.05 -0.02",
    "THIN_PRISM_FISHEYE": f"{PINHOLE_PARAMS} 0.05 -0.02 0 0 0.01 0.003 0 0",
    "RAD_TAN_THIN_PRISM_FISHEYE": f"{PINHOLE_PARAMS} 0.05 -0.02 0.01 0.003 0 0 0 0 0 0 0 0",
    "OPENCV_FISHEYE": f"{PINHOLE_PARAMS} 0.05 -0.02 0.01 0.003",
    "FOV": f"{PINHOLE_PARAMS} 0",
}
NEWER = {
    "SIMPLE_FISHEYE": "30 16 12.5",
    "FISHEYE": PINHOLE_PARAMS,
    "SIMPLE_DIVISION": "30 16 12.5 0",
    "DIVISION": f"{PINHOLE_PARAMS} 0",
    "EUCM": f"{PINHOLE_PARAMS} 0 1",
}
INEXACT = {
    "FOV": f"{PINHOLE_PARAMS} 0.9",
    "THIN_PRISM_FISHEYE": f"{PINHOLE_PARAMS} 0.05 -0.02 0 0 0.01 0.003 0.001 0",
    "RAD_TAN_THIN_PRISM_FISHEYE": f"{PINHOLE_PARAMS} 0.05 -0.02 0.01 0.003 0.1 0 0 0 0 0 0 0",
    "DIVISION": f"{PINHOLE_PARAMS} 0.1",
    "EUCM": f"{PINHOLE_PARAMS} 0.5 1",
}
PROJECT = """
import json, sys, numpy as np, pycolmap
cameras = json.load(open(sys.argv[1]))
points = np.array([[0.3, -0.2, 1.0], [-0.7, 0.4, 1.0], [0.0, 0.9, 1.0], [0.1, 0.05, 1.0]])
found = {}
for model, params in cameras.items():
    if not hasattr(pycolmap.CameraModelId, model):
        continue
    camera = pycolmap.Camera(model=model, width=32, height=24, params=params)
    found[model] = [np.array(camera.img_from_cam(point)).ravel().tolist() for point in points]
print(json.dumps([points.tolist(), found]))
"""


def test_radial_fisheyes_see_what_colmap_says_they_see(tmp_path: Path) -> None:
    cameras = {name: [float(p) for p in text.split()] for name, text in {**EXACT, **NEWER}.items()}
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    points, expected = json.loads(run_pycolmap(PROJECT, tmp_path / "cameras.json"))
    assert set(EXACT) <= set(expected)
    for model, pixels in expected.items():
        source = tmp_path / model
        text = {**EXACT, **NEWER}[model]
        write_text_model(source / "sparse", many_photos(source, 2), f"1 {model} 32 24 {text}")
        for form in ("text", "binary"):
            camera = read_any_model(source / "sparse").cameras[1]
            assert camera.model in ("OPENCV_FISHEYE", "PINHOLE")
            matrix, bend = camera.intrinsics.matrix(), camera.distortion
            if camera.model == "OPENCV_FISHEYE":
                zero = np.zeros(3)
                flat, _ = cv2.fisheye.projectPoints(np.array([points]), zero, zero, matrix, bend)
            else:
                flat = (np.array(points) @ matrix.T)[:, :2]
            found = np.asarray(flat).reshape(-1, 2)
            np.testing.assert_allclose(found, np.array(pixels) - 0.5, atol=1e-9, err_msg=model)
            if form == "text":
                imported(source, tmp_path / f"{model} out")
                write_model(source / "sparse", read_any_model(source / "sparse"))


@pytest.mark.parametrize("model", INEXACT)
def test_other_lenses_are_named_with_what_to_do(
    tmp_path: Path, model: str, capfd: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "source"
    lines = many_photos(source, 2)
    other = f"1 {model} 32 24 {INEXACT[model]}"
    write_text_model(source / "sparse", lines, other)
    error = refusal([str(source)], tmp_path / "out", capfd)
    assert f"camera 1 has model {model}" in error
    assert "colmap image_undistorter" in error
    # Where no photo was taken with it, it does no harm.
    cameras = source / "sparse" / "cameras.txt"
    cameras.write_text(f"{CAMERA}\n2{other[1:]}\n")
    assert imported(source, tmp_path / "out").images == 2


def test_panoramas_are_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "source"
    write_text_model(source / "sparse", many_photos(source, 2), "1 EQUIRECTANGULAR 32 24 32 24")
    assert "panoramas" in refusal([str(source)], tmp_path / "out", capfd)


def test_an_image_without_keypoints_has_an_empty_line(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text(f"# comment\n{CAMERA}\n")
    (tmp_path / "images.txt").write_text(
        "# comment\n1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 1 0 0 1 b.png\n\n"
    )
    (tmp_path / "points3D.txt").write_text("")
    model = read_any_model(tmp_path)
    assert [image.name for image in model.images] == ["a.png", "b.png"]
    np.testing.assert_allclose(inverse(model.images[1].camera_from_world)[:3, 3], [-1.0, 0.0, 0.0])
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png")
    with pytest.raises(InputError, match="keypoints of the last image is missing"):
        read_any_model(tmp_path)


def test_a_model_without_images_and_a_folder_without_a_model(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    arguments = [str(source), "--from", "colmap"]
    assert "holds no COLMAP model" in refusal(arguments, tmp_path / "out", capfd)
    (source / "cameras.txt").write_text(CAMERA)
    for name in ("images.txt", "points3D.txt"):
        (source / name).write_text("")
    assert "no registered image" in refusal(arguments, tmp_path / "out", capfd)
    (source / "images.txt").write_bytes(b"\xff\xfe\n")
    assert "images.txt: is no text" in refusal(arguments, tmp_path / "out", capfd)


@pytest.mark.skipif(not (SHARED / "lund_door").is_dir(), reason="needs the lund_door data")
def test_a_real_text_model_projects_onto_its_own_keypoints() -> None:
    model = read_any_model(SHARED / "lund_door" / "groundtruth_colmap_full_resolution")
    assert len(model.images) == 12
    row_of = {int(number): row for row, number in enumerate(model.points.identifiers)}
    image = model.images[0]
    camera = model.cameras[image.camera]
    seen = np.flatnonzero(image.points >= 0)
    world = inverse(image.camera_from_world)
    focal, center, radial = camera.params[0], camera.params[1:3], camera.params[3]
    errors = []
    for index in seen[::20]:
        point = model.points.positions[row_of[int(image.points[index])]]
        x, y, z = world[:3, :3].T @ (point - world[:3, 3])
        bend = 1.0 + radial * ((x / z) ** 2 + (y / z) ** 2)
        pixel = focal * bend * np.array([x / z, y / z]) + center
        errors.append(np.linalg.norm(pixel - image.keypoints[index]))
    assert np.median(errors) < 1.0
