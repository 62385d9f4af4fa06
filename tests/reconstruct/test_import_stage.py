"""``lfnav import`` as a whole: recognition, options, replacing, next command, export and back."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.dataset.camera_file import CameraFile, format_camera_file, read_camera_file
from pipelines.dataset.importers.recognition import recognise
from pipelines.dataset.importers.recording import name_below
from pipelines.dataset.importers.settings import ImportSettings
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import base_from_camera_mount
from pipelines.lightfield.colmap_export import export_scene_to_colmap
from pipelines.lightfield.scene_file import load_scene, save_scene
from pipelines.reconstruct.import_stage import import_source
from pipelines.reconstruct.reconstruction import load_reconstruction
from tests.import_samples import SHARED, refusal, run_pycolmap, write_picture
from tests.report_samples import wall_scene


def grid(folder: Path) -> Path:
    for row in (0, 1):
        for column in (0, 1):
            write_picture(folder / f"r{row}_c{column}.jpg", 10 * row + column)
    return folder


OPTIONS = ["--spacing", "0.1", "--focal", "40"]


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["transforms.json", "sparse/0/cameras.bin", "images/a.png"], "nerfstudio"),
        (["transforms_train.json"], "nerfstudio"),
        (["sparse/0/cameras.bin"], "colmap"),
        (["sparse/cameras.txt"], "colmap"),
        (["cameras.bin"], "colmap"),
        (["calib.txt", "times.txt"], "kitti"),
        (["sequences/00/calib.txt"], "kitti"),
        (["frame-000000.color.png"], "7scenes"),
        (["r00_c00.jpg"], "grid"),
        (["rgb/r00_c00.png"], "grid"),
        (["drive.MP4"], "video"),
        (["transforms.json"], "nerfstudio"),
    ],
)
def test_a_source_is_known_by_what_lies_in_it(tmp_path: Path, names: list[str], kind: str) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    source = tmp_path / names[0] if kind == "video" else tmp_path
    found = recognise(source)
    assert found.kind == kind
    assert (found.others == ("colmap",)) is (len(names) == 3)


def test_what_is_not_recognised_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plain").mkdir()
    write_picture(tmp_path / "plain" / "1.png", 1)
    assert "not recognised as any of grid" in refusal(
        [str(tmp_path / "plain")], tmp_path / "o", capfd
    )
    (tmp_path / "plain" / "rgb.txt").write_text("0 1.png\n")
    assert "is a data set already" in refusal([str(tmp_path / "plain")], tmp_path / "o", capfd)
    (tmp_path / "a.txt").write_text("")
    assert "not recognised" in refusal([str(tmp_path / "a.txt")], tmp_path / "o", capfd)
    for kind in ("grid", "colmap", "kitti", "7scenes"):
        arguments = [str(tmp_path / "a.txt"), "--from", kind, *(OPTIONS if kind == "grid" else [])]
        assert "is a file" in refusal(arguments, tmp_path / "o", capfd)


def test_options_that_mean_nothing_or_are_impossible(tmp_path: Path) -> None:
    source = grid(tmp_path / "source")
    for settings in (ImportSettings(fps=2.0), ImportSettings(upright=True)):
        with pytest.raises(OptionError, match="means nothing for a source of kind grid"):
            import_source(source, tmp_path / "out", settings, overwrite=False, progress=no_progress)
    for name in ("focal", "focus", "scale", "camera_height", "fps", "every", "max_frames"):
        for value in (0, -1, float("nan"), float("inf")):
            with pytest.raises(OptionError, match=f"--{name.replace('_', '-')}"):
                ImportSettings(**{name: value})  # type: ignore[arg-type]
    impossible: list[dict[str, Any]] = [
        {"kind": "tape"},
        {"fov": 180.0},
        {"start": -1.0},
        {"start": 3.0, "end": 2.0},
        {"image_format": "gif"},
    ]
    for wrong in impossible:
        with pytest.raises(OptionError):
            ImportSettings(**wrong)
    with pytest.raises(OptionError, match="--camera 'image_9' is none of image_0"):
        ImportSettings(camera="image_9").check_meant_for("kitti")
    assert not (tmp_path / "out").exists()


def test_the_command_says_what_it_took_the_source_for_and_what_is_next(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    source, output = grid(tmp_path / "source"), tmp_path / "a b"
    arguments = ["import", str(source), "-o", str(output), *OPTIONS]
    assert common.run_command(main, arguments) == 0
    out = capfd.readouterr().out
    assert "grid (r0_c0.jpg)" in out
    assert f"lfnav model '{output}/reconstruction' -o scene.h5" in out
    # Nothing is replaced unasked, and only what an import made.
    assert common.run_command(main, arguments) == 1
    assert "--overwrite" in capfd.readouterr().err
    assert common.run_command(main, [*arguments, "--overwrite", "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["source"] == "grid"
    assert found["images"] == 4
    shutil.copytree(source, tmp_path / "mine")
    arguments = ["import", str(source), "-o", str(tmp_path / "mine"), *OPTIONS, "--overwrite"]
    assert common.run_command(main, arguments) == 1
    assert "will not be overwritten" in capfd.readouterr().err
    assert (tmp_path / "mine" / "r0_c0.jpg").is_file()


def test_the_same_source_gives_the_same_bytes(tmp_path: Path) -> None:
    source = grid(tmp_path / "source")
    settings = ImportSettings(spacing=(0.1, 0.1), focal=40.0)
    contents = []
    for _ in range(2):
        import_source(source, tmp_path / "out", settings, overwrite=True, progress=no_progress)
        files = sorted(path for path in (tmp_path / "out").rglob("*") if path.is_file())
        contents.append({path: path.read_bytes() for path in files})
    assert contents[0] == contents[1]
    record = json.loads((tmp_path / "out" / "import.json").read_text())
    assert record["source"] == "grid"


@pytest.mark.parametrize("angles_deg", [(0.0, 0.0, 0.0), (10.0, -20.0, 170.0), (5.0, 90.0, 0.0)])
def test_camera_files_are_read_back(tmp_path: Path, angles_deg: tuple[float, ...]) -> None:
    camera = Camera("OPENCV", 640, 480, (577.3, 577.1, 319.5, 239.25, 0.1, -1e-17, 0.0, 2e-3))
    mount = base_from_camera_mount((0.1, -0.2, 1.65), angles_deg)
    path = tmp_path / "camera.toml"
    path.write_text(format_camera_file(CameraFile(camera, mount, 5000.0)))
    found = read_camera_file(path)
    assert found.camera == camera
    assert found.depth_scale == 5000.0
    assert found.base_from_camera is not None
    np.testing.assert_allclose(found.base_from_camera, mount, atol=1e-12)
    path.write_text(format_camera_file(CameraFile(camera, None, None)))
    assert read_camera_file(path) == CameraFile(camera, None, None)


# ---------------------------------------------------------------------------- export to COLMAP

READ_MODEL = """
import json, sys, pycolmap
rec = pycolmap.Reconstruction(sys.argv[1])
print(json.dumps({im.name: [im.cam_from_world().inverse().matrix().tolist(),
    im.camera.model.name, im.camera.params.tolist()] for im in rec.images.values()}))
"""


def test_colmap_itself_reads_an_exported_scene_and_import_brings_it_back(tmp_path: Path) -> None:
    save_scene(tmp_path / "scene.h5", wall_scene(), overwrite=False)
    scene = load_scene(tmp_path / "scene.h5")
    arguments = ["export", str(tmp_path / "scene.h5"), "--format", "colmap"]
    assert common.run_command(main, [*arguments, "-o", str(tmp_path / "project")]) == 0
    found = json.loads(run_pycolmap(READ_MODEL, tmp_path / "project" / "sparse"))
    assert sorted(found) == sorted(scene.image_names)
    for row, name in enumerate(scene.image_names):
        matrix, model, params = found[name]
        np.testing.assert_allclose(matrix, scene.world_from_camera[row, :3], atol=1e-9)
        assert (model, params) == ("SIMPLE_PINHOLE", [24.0, 24.0, 18.0])
        assert (tmp_path / "project" / "images" / name).read_bytes() == scene.encoded_images[row]
    settings = ImportSettings(scale=1.0)
    import_source(
        tmp_path / "project", tmp_path / "back", settings, overwrite=False, progress=no_progress
    )
    content = load_reconstruction(tmp_path / "back" / "reconstruction")
    np.testing.assert_allclose(content.world_from_camera, scene.world_from_camera, atol=1e-9)
    assert content.cameras == scene.cameras


@pytest.mark.parametrize(
    ("names", "reason"),
    [
        (("../a.png", "b.png", "c.png"), "no file name"),
        (("/tmp/a.png", "b.png", "c.png"), "no file name"),
        (("", "b.png", "c.png"), "no file name"),
        (("b.png", "b.png", "c.png"), "same name"),
        (("b.png", "b.png/c", "c.png"), "'b.png', which is also a folder"),
    ],
)
def test_image_names_of_a_strangers_scene_stay_in_the_folder(
    tmp_path: Path, names: tuple[str, ...], reason: str
) -> None:
    save_scene(tmp_path / "s.h5", replace(wall_scene(), image_names=names), overwrite=False)
    with pytest.raises(InputError, match=reason):
        export_scene_to_colmap(tmp_path / "s.h5", tmp_path / "out" / "project", overwrite=False)
    assert [path.name for path in tmp_path.rglob("*") if path.suffix == ".png"] == []
    assert not (tmp_path / "out" / "project").exists()


def test_export_refuses_what_it_cannot_do(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    save_scene(tmp_path / "s.h5", wall_scene(), overwrite=False)
    start = ["export", str(tmp_path / "s.h5"), "--format", "colmap", "-o"]
    assert common.run_command(main, [*start, str(tmp_path / "p"), "--estimate", "mean"]) == 2
    assert "--estimate is for runs" in capfd.readouterr().err
    assert not (tmp_path / "p").exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("mine")
    assert common.run_command(main, [*start, str(tmp_path / "mine"), "--overwrite"]) == 1
    assert (tmp_path / "mine" / "file").read_text() == "mine"


@pytest.mark.skipif(not (SHARED / "cards").is_dir(), reason="needs the cards light field")
def test_the_cards_light_field_is_recognised() -> None:
    assert recognise(SHARED / "cards").kind == "grid"


def test_images_are_kept_in_one_folder_under_names_that_a_list_can_hold() -> None:
    source = Path("cameras.txt")
    assert name_below("rgb", "b/1.png", source) == "rgb/b/1.png"
    assert name_below("rgb", "./rgb/1.png", source) == "rgb/1.png"
    for name in ("", ".", "/a.png", "../a.png", "a/../../b.png", "a\n.png", "a\0.png", "a.png "):
        with pytest.raises(InputError, match=r"leads out|no file name"):
            name_below("rgb", name, source)
