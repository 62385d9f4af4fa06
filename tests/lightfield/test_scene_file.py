"""``scene.h5``: read back as written, and refused with one line where something is wrong."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipelines.artifacts.errors import InputError
from pipelines.artifacts.safe_hdf5 import write_array, write_json
from pipelines.dataset.images import encode_jpeg, encode_png
from pipelines.geometry.camera import Camera
from pipelines.geometry.plane import plane_from_coefficients
from pipelines.geometry.pose import base_from_camera_mount
from pipelines.lightfield.description import describe_scene
from pipelines.lightfield.scene import PlaneEstimate, Scene, covered_bounds
from pipelines.lightfield.scene_file import (
    SCHEMA_VERSION,
    identifier_of,
    load_scene,
    save_scene,
    scene_provenance,
)
from tests.lightfield_samples import WALL, looking

SAMPLE = Path(__file__).parents[2] / "sample_data" / "elevators" / "map" / "rgb" / "0000.jpg"


def identified(scene: Scene) -> Scene:
    return replace(
        scene,
        identifier=identifier_of(
            scene.encoded_images,
            scene.cameras,
            scene.camera_index,
            scene.world_from_camera,
            scene.surface,
            scene.base_from_camera,
        ),
    )


def small_scene(**changes: Any) -> Scene:
    """Three photos by two cameras, JPEG and PNG."""
    generator = np.random.default_rng(0)
    cameras = (
        Camera("OPENCV", 24, 16, (20.0, 21.0, 11.5, 7.5, -0.1, 0.01, 0.001, -0.002)),
        Camera("PINHOLE", 10, 14, (9.0, 9.5, 4.5, 6.5)),
    )
    first, second, third = (
        generator.integers(0, 256, shape).astype(np.uint8)
        for shape in ((16, 24, 3), (14, 10, 3), (16, 24, 3))
    )
    scene = Scene(
        image_names=("rgb/a ä.jpg", "rgb/b.png", "rgb/c.png"),
        encoded_images=(encode_jpeg(first), encode_png(second), encode_png(third)),
        timestamps=np.array([1305031102.175304, 1305031102.211214, 1305031103.0]),
        cameras=cameras,
        camera_index=np.array([0, 1, 0]),
        world_from_camera=np.array(
            [looking([x, -2.0, 1.0], [0.3 * x, 0.0, 1.0], 0.1) for x in (-1.0, 0.1, 1.0)]
        ),
        surface=PlaneEstimate(
            plane_from_coefficients([0.1, -1.0, 0.02, 0.3]), 0.013, float("inf"), "photos", 0.61
        ),
        base_from_camera=base_from_camera_mount([0.1, 0.0, 0.7], [0.0, 5.0, 0.0]),
        bounds=np.array([-2.0, 2.0, -3.0, 0.5]),
        scale_source="odometry",
        identifier="",
    )
    return identified(replace(scene, **changes))


def saved(path: Path, scene: Scene | None = None) -> Path:
    save_scene(path, small_scene() if scene is None else scene, overwrite=False)
    return path


def altered(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Changes the JSON part of a scene as somebody with a proper tool would: checksums fit."""
    with h5py.File(path, "r+") as file:
        description = json.loads(file["scene"][()].tobytes())
        change(description)
        del file["scene"]
        write_json(file, "scene", description)


def with_array(path: Path, name: str, value: Any) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]
        write_array(file, name, value)


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


@pytest.mark.parametrize("has_mount", [True, False])
def test_round_trip(tmp_path: Path, has_mount: bool) -> None:
    scene = small_scene() if has_mount else small_scene(base_from_camera=None)
    loaded = load_scene(saved(tmp_path / "s.h5", scene))
    for name in (
        "image_names",
        "encoded_images",
        "cameras",
        "scale_source",
        "identifier",
    ):
        assert getattr(loaded, name) == getattr(scene, name)
    for name in ("timestamps", "camera_index", "world_from_camera", "bounds", "base_from_camera"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(scene, name))
        assert (getattr(loaded, name) is None) == (getattr(scene, name) is None)
    np.testing.assert_allclose(
        loaded.plane.coefficients(), scene.plane.coefficients(), rtol=0.0, atol=1e-15
    )
    for name in ("offset_sigma", "angle_sigma", "method", "quality"):
        assert getattr(loaded.surface, name) == getattr(scene.surface, name)
    assert len(loaded) == 3
    assert loaded.camera_of(1).model == "PINHOLE"
    assert loaded.image(1).shape == (14, 10, 3)


def test_the_same_scene_gives_the_same_file(tmp_path: Path) -> None:
    provenance = {"stage": "model", "settings": {"seed": 3}}
    for name in ("a.h5", "b.h5"):
        save_scene(tmp_path / name, small_scene(), overwrite=False, provenance=provenance)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    assert scene_provenance(tmp_path / "a.h5") == provenance
    # A scene that was read and written again stays the same, rounding included.
    save_scene(tmp_path / "c.h5", load_scene(tmp_path / "a.h5"), False, provenance)
    assert load_scene(tmp_path / "c.h5").identifier == small_scene().identifier


def test_photos_are_kept_as_recorded(tmp_path: Path) -> None:
    """Byte for byte, as other programs see them in the file too."""
    data = SAMPLE.read_bytes()
    camera = Camera("PINHOLE", 640, 480, (577.0, 577.0, 319.5, 239.5))
    scene = small_scene()
    scene = small_scene(
        encoded_images=(data, *scene.encoded_images[1:]),
        cameras=(*scene.cameras, camera),
        camera_index=np.array([2, 1, 0]),
    )
    path = saved(tmp_path / "s.h5", scene)
    assert load_scene(path).encoded_images[0] == data
    with h5py.File(path) as file:
        assert file["images/000000"][()].tobytes() == data
        assert all(file[f"images/{i:06d}"].fletcher32 for i in range(3))


def test_existing_file_needs_overwrite(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    path.write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        save_scene(path, small_scene(), overwrite=False)
    assert path.read_text() == "mine"
    save_scene(path, small_scene(), overwrite=True)
    assert len(load_scene(path)) == 3
    assert list(tmp_path.iterdir()) == [path]


def test_truncated_and_foreign_files(tmp_path: Path) -> None:
    data = saved(tmp_path / "s.h5").read_bytes()
    contents = {"half": data[: len(data) // 2], "short": data[:-100], "text": b"hi", "no": b""}
    for name, content in contents.items():
        path = tmp_path / f"{name}.h5"
        path.write_bytes(content)
        refusal(path)
    assert "not" in refusal(tmp_path / "text.h5")
    refusal(tmp_path / "missing.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = 1
    refusal(tmp_path / "other.h5")


def test_flipped_bits_in_a_photo_are_noticed(tmp_path: Path) -> None:
    path = saved(tmp_path / "s.h5")
    data = bytearray(path.read_bytes())
    place = data.find(small_scene().encoded_images[2])
    assert place > 0
    data[place + 60] ^= 1
    path.write_bytes(bytes(data))
    assert "damaged" in refusal(path)


def test_newer_schema_and_other_formats(tmp_path: Path) -> None:
    path = saved(tmp_path / "s.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = SCHEMA_VERSION + 1
    assert "newer lfnav" in refusal(path)
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        file.attrs["format"] = np.bytes_("lfnav run")
    assert "lfnav run" in refusal(path)


def test_an_image_of_another_scene_in_its_place(tmp_path: Path) -> None:
    """Of the right size and with a checksum that fits: the identifier does not."""
    path = saved(tmp_path / "s.h5")
    other = encode_png(np.zeros((14, 10, 3), np.uint8))
    with_array(path, "images/000001", np.frombuffer(other, np.uint8))
    assert "changed after it was written" in refusal(path)


def test_whatever_decides_the_look_decides_the_identifier(tmp_path: Path) -> None:
    scene = small_scene()
    assert scene.surface is not None
    moved = scene.world_from_camera.copy()
    moved[1, 0, 3] += 1e-9
    others = [
        small_scene(encoded_images=scene.encoded_images[:2] + scene.encoded_images[:1]),
        small_scene(world_from_camera=moved),
        small_scene(surface=replace(scene.surface, plane=WALL)),
        small_scene(base_from_camera=None),
        small_scene(cameras=(scene.cameras[0], Camera("PINHOLE", 10, 14, (9.1, 9.5, 4.5, 6.5)))),
        small_scene(camera_index=np.array([0, 1, 1])),
    ]
    assert len({scene.identifier, *(other.identifier for other in others)}) == 7
    # Names, bounds and how sure the plane is change nothing that is rendered.
    same = small_scene(bounds=scene.bounds + 1.0, surface=replace(scene.surface, offset_sigma=9.0))
    assert same.identifier == scene.identifier
    # So a changed focal length is noticed like a changed photo.
    path = saved(tmp_path / "s.h5")
    altered(path, lambda json: json["cameras"][1].update(params=[12.0, 9.5, 4.5, 6.5]))
    assert "changed after it was written" in refusal(path)


def test_a_pose_that_is_not_rigid(tmp_path: Path) -> None:
    poses = small_scene().world_from_camera
    for change in (1.001, -1.0, np.nan, np.inf):
        path = tmp_path / f"{change}.h5"
        bad = poses.copy()
        bad[1, :3, 0] *= change
        saved(path, small_scene(world_from_camera=bad))
        assert "no rigid transform" in refusal(path)
    bad = poses.copy()
    bad[2, 3, 0] = 0.5
    assert "no rigid transform" in refusal(
        saved(tmp_path / "row.h5", small_scene(world_from_camera=bad))
    )
    mount = small_scene().base_from_camera
    assert mount is not None
    saved(tmp_path / "m.h5", small_scene(base_from_camera=np.diag([2.0, 1.0, 1.0, 1.0]) @ mount))
    assert "no rigid transform" in refusal(tmp_path / "m.h5")


def test_no_views(tmp_path: Path) -> None:
    empty = small_scene(
        image_names=(),
        encoded_images=(),
        timestamps=np.empty(0),
        camera_index=np.empty(0, dtype=np.int64),
        world_from_camera=np.empty((0, 4, 4)),
    )
    assert "no views" in refusal(saved(tmp_path / "s.h5", empty))


def test_photo_and_camera_differ_in_size(tmp_path: Path) -> None:
    scene = small_scene(camera_index=np.array([0, 0, 0]))
    assert "photo 1 and its camera differ in size" in refusal(saved(tmp_path / "s.h5", scene))


@pytest.mark.parametrize("index", [2, -1, 2**40])
def test_camera_index_out_of_range(tmp_path: Path, index: int) -> None:
    path = saved(tmp_path / "s.h5")
    with_array(path, "camera_index", np.array([0, index, 0]))
    assert "a camera that it does not hold" in refusal(path)


@pytest.mark.parametrize(
    "bounds",
    [[1.0, 1.0, 0.0, 1.0], [0.0, 1.0, 2.0, 1.0], [0.0, np.nan, 0.0, 1.0], [0.0, 1e-300, 0.0, 1.0]],
)
def test_bounds_without_area(tmp_path: Path, bounds: list[float]) -> None:
    path = saved(tmp_path / "s.h5", small_scene(bounds=np.array(bounds)))
    assert "enclose no area" in refusal(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda json: json.pop("surface"),
        lambda json: json.update(image_names=5),
        lambda json: json.update(cameras=[{"model": "FISH"}]),
        lambda json: json["cameras"][0].update(params=[1, 2]),
        lambda json: json["cameras"][0].update(model="FISH"),
        lambda json: json["cameras"][0].update(width="wide"),
        lambda json: json["surface"].update(plane=[0, 0, 0, 1]),
        lambda json: json["surface"].update(plane=[1, 0, 0]),
        lambda json: json["surface"].update(quality=[]),
        lambda json: json["image_names"].append("one more"),
        lambda json: json["image_names"].pop(),
    ],
)
def test_descriptions_that_make_no_sense(
    tmp_path: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    path = saved(tmp_path / "s.h5")
    altered(path, change)
    refusal(path)


@pytest.mark.parametrize("name", ["scene", "timestamps", "bounds", "images/000001"])
def test_missing_parts(tmp_path: Path, name: str) -> None:
    path = saved(tmp_path / "s.h5")
    with h5py.File(path, "r+") as file:
        del file[name]
    assert name in refusal(path)


def test_a_photo_that_is_no_photo(tmp_path: Path) -> None:
    data = small_scene().encoded_images
    scene = small_scene(encoded_images=(data[0], b"no image at all", data[2]))
    refusal(saved(tmp_path / "s.h5", scene))


def test_summary_says_how_sure_the_plane_is(tmp_path: Path) -> None:
    path = saved(tmp_path / "s.h5")
    summary = describe_scene(path)
    facts = summary.to_dict()
    json.dumps(facts, allow_nan=False)
    assert facts["views"] == 3
    assert facts["plane"]["offset_sigma_m"] == 0.013
    assert facts["plane"]["angle_sigma_deg"] is None
    assert facts["identifier"] == small_scene().identifier
    rows = {row[0]: row[1] for row in summary.table()}
    assert "uncertainty unknown" in rows["plane from"]
    sure = small_scene(surface=PlaneEstimate(WALL, 0.013, np.radians(0.5), "points", 0.8))
    save_scene(path, sure, overwrite=True)
    rows = {row[0]: row[1] for row in describe_scene(path).table()}
    assert "80%" in rows["plane from"]
    assert "1.3 cm, 0.50 deg" in rows["plane from"]
    assert rows["area"].count(" m") == 2
    save_scene(path, replace(identified(sure), scale_source="arbitrary"), overwrite=True)
    rows = {row[0]: row[1] for row in describe_scene(path).table()}
    assert "0.013 units, 0.50 deg" in rows["plane from"]
    assert rows["area"].count(" units") == 2
    assert " m" not in rows["area"]


def test_bounds_span_positions_and_what_they_show() -> None:
    """One camera two metres from the wall, 90 degrees wide: it shows the wall from -1 to 3."""
    camera = Camera("PINHOLE", 101, 75, (50.0, 50.0, 50.0, 37.0))
    pose = looking([1.0, -2.0, 1.0], [1.0, 0.0, 1.0])[None]
    np.testing.assert_allclose(
        covered_bounds(pose, [camera], WALL), [-1.0, 3.0, -2.5, 0.0], atol=1e-9
    )
    # A view that grazes the wall meets it far away; that is no place for a robot.
    poses = np.concatenate([pose, looking([1.0, -2.0, 1.0], [21.0, 0.0, 1.0])[None]])
    low_x, high_x, low_y, high_y = covered_bounds(poses, [camera] * 2, WALL)
    assert (low_x, low_y, high_y) == pytest.approx((-1.0, -2.5, 0.0))
    assert 3.0 < high_x < 15.0
    # Only positions are left where no view meets the surface.
    away = looking([1.0, -2.0, 1.0], [1.0, -9.0, 1.0])[None]
    np.testing.assert_allclose(covered_bounds(away, [camera], WALL), [0.5, 1.5, -2.5, -1.5])
