"""Compact storage: the same light field in fewer bytes, and as safe as the other."""

import functools
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, features

from lfnav_cli.common import run_command
from lfnav_cli.main import main
from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.safe_hdf5 import write_array
from pipelines.dataset.images import decode_image, encode_jpeg, encode_png
from pipelines.dataset.webp import encode_webp, webp_header
from pipelines.geometry.camera import Camera
from pipelines.lightfield.colmap_export import export_scene_to_colmap
from pipelines.lightfield.compact import DEPTH_SIDE, PHOTO_SIDE, compact_scene
from pipelines.lightfield.depth_storage import as_stored, differences_of, levels_of
from pipelines.lightfield.description import describe_scene
from pipelines.lightfield.scene import Scene, SceneDepth
from pipelines.lightfield.scene_file import (
    load_scene,
    save_scene,
)
from pipelines.lightfield.stage import ModelSettings
from pipelines.lightfield.views import views_of_scene
from tests.lightfield.test_scene_file import altered, refusal, saved, small_scene

LENS = Camera("OPENCV", 720, 541, (600.0, 606.0, 361.0, 267.0, -0.12, 0.02, 0.001, -0.002))
SMALL = Camera("SIMPLE_PINHOLE", 60, 45, (50.0, 29.5, 22.0))


def photo(camera: Camera) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Something smooth with edges in it."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    waves = 128 + 60 * np.sin(columns / 17.0) + 40 * np.cos(rows / 11.0)
    image = np.stack([waves, 255 - waves, 0.5 * waves + 50], axis=2)
    image[rows > 0.7 * camera.height] *= 0.4
    return image.clip(0, 255).astype(np.uint8)


def depth_of(camera: Camera) -> SceneDepth:
    """A slanted wall with a step in it, a hole, and a part that is not confident."""
    size = (camera.height * 2 // 3, camera.width * 2 // 3)
    rows, columns = np.mgrid[: size[0], : size[1]]
    inverse = 0.3 + 0.0003 * columns + 0.0001 * rows + 0.2 * (columns > size[1] // 2)
    inverse[:3, :4] = 0.0
    return as_stored(inverse.astype(np.float32), (columns + rows) % 7 > 1)


def full_scene(has_depth: bool = True) -> Scene:
    images = (encode_jpeg(photo(LENS)), encode_png(photo(SMALL)), encode_png(photo(LENS)))
    scene = small_scene(encoded_images=images, cameras=(LENS, SMALL))
    if not has_depth:
        return scene
    return replace(scene, depth=tuple(map(depth_of, (LENS, SMALL, LENS))))


@functools.cache
def made(has_depth: bool = True) -> Scene:
    return compact_scene(full_scene(has_depth))


def compact(path: Path, has_depth: bool = True) -> Path:
    save_scene(path, made(has_depth), overwrite=False)
    return path


@pytest.mark.parametrize("has_depth", [True, False])
def test_it_shows_what_docking_and_localization_take_of_the_recorded_photos(
    tmp_path: Path, has_depth: bool
) -> None:
    full = full_scene(has_depth)
    scene = load_scene(compact(tmp_path / "s.h5", has_depth))
    expected, found = views_of_scene(full, PHOTO_SIDE), views_of_scene(scene)
    assert found.has_depth == has_depth
    for view in range(3):
        assert found.intrinsics[view] == expected.intrinsics[view]
        difference = found.level(view, 0).astype(float) - expected.level(view, 0)
        assert np.sqrt(np.mean(difference**2)) < 8.0
    np.testing.assert_array_equal(found.arrays.projection, expected.arrays.projection)
    if has_depth:
        expected = views_of_scene(full, DEPTH_SIDE)
        for view in range(3):
            near, there = expected.depth_map(view), found.depth_map(view)
            # Half a level of the power of two that a thousand of them need.
            assert np.abs(there - near).max() <= 0.5 * 2.0**-10
            np.testing.assert_array_equal(there == 0.0, near == 0.0)


def test_confidence_is_that_of_the_pixels_that_are_kept() -> None:
    full = full_scene()
    for before, after in zip(full.depth, compact_scene(full).depth, strict=True):
        height, width = after.inverse_depth.shape
        rows = np.arange(height) * before.inverse_depth.shape[0] // height
        columns = np.arange(width) * before.inverse_depth.shape[1] // width
        np.testing.assert_array_equal(after.confident, before.confident[rows][:, columns])


def test_losses_are_those_of_the_stored_photos_and_depth() -> None:
    full = full_scene()
    scene = compact_scene(full)
    assert scene.compaction is not None
    assert scene.compaction.recorded_bytes == sum(map(len, full.encoded_images))
    expected, found = views_of_scene(full, PHOTO_SIDE), views_of_scene(scene)
    errors = [
        np.mean((found.level(v, 0).astype(float) - expected.level(v, 0)) ** 2) for v in range(3)
    ]
    psnr = 10 * np.log10(255.0**2 / np.mean(errors))
    assert scene.compaction.photo_psnr == pytest.approx(psnr, abs=1e-9)
    assert scene.compaction.depth_error is not None
    assert 0.0 < scene.compaction.depth_error < 0.002
    flat = compact_scene(full_scene(has_depth=False)).compaction
    assert flat is not None
    assert flat.depth_error is None


def test_round_trip_to_the_byte(tmp_path: Path) -> None:
    loaded = load_scene(compact(tmp_path / "a.h5"))
    assert loaded.identifier == made().identifier
    assert loaded.identifier != full_scene().identifier
    assert loaded.compaction == made().compaction
    save_scene(tmp_path / "b.h5", loaded, overwrite=False)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_only_compact_scenes_are_closed_to_earlier_versions(tmp_path: Path) -> None:
    saved(tmp_path / "full.h5")
    compact(tmp_path / "compact.h5")
    for name, version in (("full", 1), ("compact", 2)):
        with h5py.File(tmp_path / f"{name}.h5") as file:
            assert file.attrs["schema_version"] == version
    # As an earlier version reads it, which does not know WebP.
    with h5py.File(tmp_path / "compact.h5", "r+") as file:
        file.attrs["schema_version"] = np.int64(1)
    altered(tmp_path / "compact.h5", lambda description: description.pop("compaction"))
    refusal(tmp_path / "compact.h5")


def test_it_takes_a_fraction_of_the_bytes(tmp_path: Path) -> None:
    save_scene(tmp_path / "full.h5", full_scene(), overwrite=False)
    full = (tmp_path / "full.h5").stat().st_size
    assert compact(tmp_path / "s.h5").stat().st_size < 0.5 * full


levels = arrays.arrays(np.uint16, arrays.array_shapes(min_dims=2, max_dims=2))


@given(levels)
def test_differences_turn_back(values: np.ndarray[Any, np.dtype[np.uint16]]) -> None:
    coded = differences_of(values)
    assert coded.dtype == np.uint16
    np.testing.assert_array_equal(levels_of(coded), values)


@given(st.integers(0, 500), st.integers(-5, 5), st.integers(-5, 5))
def test_a_flat_surface_leaves_no_differences(start: int, right: int, down: int) -> None:
    rows, columns = np.mgrid[:9, :12]
    values = (500 + start + right * columns + down * rows).astype(np.uint16)
    assert not differences_of(values)[1:, 1:].any()
    # 0, -1, 1, -2 become 0, 1, 2, 3.
    np.testing.assert_array_equal(
        differences_of(np.array([[0, 65535, 65535, 65536 - 1 + 2]]).astype(np.uint16)),
        [[0, 1, 0, 4]],
    )


def put(path: Path, name: str, value: Any, old: str = "") -> None:
    with h5py.File(path, "r+") as file:
        del file[old or name]
        write_array(file, name, value)


def animated(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "WEBP", save_all=True, append_images=[image.rotate(90)])
    return buffer.getvalue()


def test_hostile_photos(tmp_path: Path) -> None:
    good = made().encoded_images[1]
    other = encode_webp(np.zeros((45, 61, 3), dtype=np.uint8), 50)
    photos = {
        "jpeg": (encode_jpeg(photo(SMALL)), "no WebP"),
        "png": (encode_png(photo(SMALL)), "no WebP"),
        "animated": (animated(Image.fromarray(photo(SMALL))), "another kind"),
        "truncated": (good[:-10], "truncated"),
        "bomb": (good[:26] + b"\xff\x3f\xff\x3f" + good[30:], "16383x16383 pixels"),
        "size": (other, "photo 1 and its camera differ in size"),
        "exchanged": (encode_webp(np.zeros((45, 60, 3), dtype=np.uint8), 50), "was changed"),
    }
    for name, (data, reason) in photos.items():
        path = compact(tmp_path / f"{name}.h5")
        put(path, "images/000001", np.frombuffer(data, np.uint8))
        assert reason in refusal(path), name


def test_a_full_scene_holds_photos_as_recorded_of_whatever_kind(tmp_path: Path) -> None:
    first, second, third = small_scene().encoded_images
    lossless = io.BytesIO()
    picture = decode_image(second, "photo")
    Image.fromarray(picture).save(lossless, "WEBP", lossless=True)
    scene = small_scene(encoded_images=(first, lossless.getvalue(), third))
    path = saved(tmp_path / "s.h5", scene)
    np.testing.assert_array_equal(load_scene(path).image(1), picture)


def test_hostile_depth(tmp_path: Path) -> None:
    name = "depth/000001"
    shape = made().depth[1].inverse_depth.shape
    changes = {
        "wide": (f"{name}/differences", np.ones(shape, np.uint32)),
        "flat": (f"{name}/differences", np.ones(50, np.uint16)),
        "other": (f"{name}/differences", np.ones((10, 10), np.uint16)),
        "bits": (f"{name}/confident_bits", np.ones(3, np.uint8)),
        "words": (f"{name}/confident_bits", np.ones(-(-shape[0] * shape[1] // 8), np.uint16)),
        "zero": (f"{name}/differences", np.zeros(shape, np.uint16)),
        "scale": (f"{name}/scale", np.array([np.inf])),
        "full": (f"{name}/inverse", np.ones(shape, np.uint16)),
    }
    for label, (array, value) in changes.items():
        path = compact(tmp_path / f"{label}.h5")
        put(path, array, value, f"{name}/differences" if label == "full" else "")
        assert name in refusal(path), label


@pytest.mark.parametrize(
    "change",
    [
        lambda losses: losses.pop("photo_psnr"),
        lambda losses: losses.update(photo_psnr="good"),
        lambda losses: losses.update(recorded_bytes=-1),
        lambda losses: losses.update(depth_error=[]),
    ],
)
def test_losses_that_make_no_sense(tmp_path: Path, change: Callable[[Any], None]) -> None:
    path = compact(tmp_path / "s.h5")
    altered(path, lambda description: change(description["compaction"]))
    refusal(path)


def test_a_picture_that_cannot_be_decoded_is_named() -> None:
    data = made().encoded_images[0]
    # Sizes fit, and the first partition is claimed to be larger than all of them.
    broken = data[:20] + bytes([data[20] | 0xE0, 0xFF, 0xFF]) + data[23:]
    webp_header(broken, "a.webp")
    with pytest.raises(InputError, match="a damaged WebP") as caught:
        replace(made(), encoded_images=(broken,) * 3).image(0)
    assert "\n" not in str(caught.value)


def test_summary_says_bytes_and_losses(tmp_path: Path) -> None:
    summary = describe_scene(compact(tmp_path / "s.h5"))
    facts = summary.to_dict()["storage"]
    scene = summary.scene
    assert scene.compaction is not None
    assert facts["kind"] == "compact"
    assert facts["photo_bytes_per_view"] == sum(map(len, scene.encoded_images)) / 3
    assert facts["photo_psnr_db"] == scene.compaction.photo_psnr
    text = {row[0]: row[1] for row in summary.table()}["storage"]
    assert f"{scene.compaction.photo_psnr:.1f} dB" in text
    saved(tmp_path / "full.h5")
    rows = {row[0]: row[1] for row in describe_scene(tmp_path / "full.h5").table()}
    assert rows["storage"] == "full: photos as recorded"


def test_export_to_colmap_writes_png(tmp_path: Path) -> None:
    path = compact(tmp_path / "s.h5")
    scene = load_scene(path)
    summary = export_scene_to_colmap(path, tmp_path / "project", overwrite=False)
    names = ["rgb/a ä.png", "rgb/b.png", "rgb/c.png"]
    for index, name in enumerate(names):
        data = (tmp_path / "project" / "images" / name).read_bytes()
        np.testing.assert_array_equal(decode_image(data, name), scene.image(index))
    assert "PNG" in {row[0]: row[1] for row in summary.table()}["images"]
    renamed = tmp_path / "renamed.h5"
    compact(renamed)
    altered(renamed, lambda json: json.update(image_names=["x.jpg", "x.png", "y.png"]))
    with pytest.raises(InputError, match="two views have the same name"):
        export_scene_to_colmap(renamed, tmp_path / "other", overwrite=False)
    assert not (tmp_path / "other").exists()


def test_storage_that_there_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(OptionError, match="storage"):
        ModelSettings(storage="tiny")
    output = tmp_path / "s.h5"
    arguments = ["model", str(tmp_path), "-o", str(output), "--storage", "tiny"]
    assert run_command(main, arguments) == 2
    assert "'tiny'" in capsys.readouterr().err
    assert not output.exists()


def test_a_pillow_without_webp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = compact(tmp_path / "s.h5")
    monkeypatch.setattr(features, "check", lambda name: False)
    with pytest.raises(StageError, match="pip install"):
        load_scene(path)
    with pytest.raises(StageError, match="pip install"):
        compact_scene(full_scene())
    # Full storage needs none.
    load_scene(saved(tmp_path / "full.h5"))
