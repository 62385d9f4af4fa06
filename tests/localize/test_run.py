"""The run in memory and its file."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.safe_hdf5 import write_json
from pipelines.localize.run import (
    Run,
    load_run,
    save_run,
)
from pipelines.localize.scene_of_run import (
    check_run_belongs_to,
    locate_scene,
    relative_scene_path,
)
from tests.localize_samples import curved_path, frame_record, run_along, spatial_run


def sample_run() -> Run:
    path = curved_path(4)
    return run_along(path, groundtruth=path + 0.01, odometry=path - 1.0)


def test_a_run_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    run = sample_run()
    save_run(tmp_path / "run.h5", run, overwrite=False)
    loaded = load_run(tmp_path / "run.h5")
    for name in ("scene_identifier", "scene_path", "dataset_name", "camera", "settings", "seed"):
        assert getattr(loaded, name) == getattr(run, name)
    assert loaded.encoded_images == run.encoded_images
    assert loaded.groundtruth is not None
    assert loaded.odometry is not None
    np.testing.assert_array_equal(loaded.groundtruth, run.groundtruth)
    np.testing.assert_array_equal(loaded.odometry, run.odometry)
    np.testing.assert_array_equal(loaded.base_from_camera, run.base_from_camera)
    for read, written in zip(loaded.frames, run.frames, strict=True):
        for name in ("particles", "log_weights", "modes", "covariance"):
            np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
        for name in ("timestamp", "image_name", "confidence", "status", "effective_sample_size"):
            assert getattr(read, name) == getattr(written, name)
        assert dict(read.seconds) == dict(written.seconds)
        assert set(read.estimates) == {"mode", "max_weight"}
        np.testing.assert_array_equal(read.estimates["mode"], written.estimates["mode"])


def test_odometry_ground_truth_and_weights_may_be_missing(tmp_path: Path) -> None:
    run = run_along(curved_path(2))
    frame = run.frames[0]
    with np.errstate(divide="ignore"):
        one_takes_all = np.log(np.eye(len(frame.particles))[3])
    run = replace(run, frames=(replace(frame, log_weights=one_takes_all), *run.frames[1:]))
    save_run(tmp_path / "run.h5", run, overwrite=False)
    loaded = load_run(tmp_path / "run.h5")
    assert loaded.odometry is None
    assert loaded.groundtruth is None
    np.testing.assert_array_equal(loaded.frames[0].log_weights, one_takes_all)


def datasets(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: (
                found.__setitem__(name, item[()].tobytes())
                if isinstance(item, h5py.Dataset)
                else None
            )
        )
    return found


def test_wall_time_leaves_all_datasets_the_same(tmp_path: Path) -> None:
    run = sample_run()
    slower = replace(
        run, frames=tuple(replace(frame, seconds={"prepare": 9.0, "likelihood": 8.0})
                          for frame in run.frames)
    )  # fmt: skip
    save_run(tmp_path / "a.h5", run, overwrite=False)
    save_run(tmp_path / "b.h5", slower, overwrite=False)
    first, second = datasets(tmp_path / "a.h5"), datasets(tmp_path / "b.h5")
    assert len(first) > 4 * 6
    assert first == second
    assert load_run(tmp_path / "b.h5").frames[0].seconds["likelihood"] == 8.0


def test_the_same_run_gives_the_same_file(tmp_path: Path) -> None:
    save_run(tmp_path / "a.h5", sample_run(), overwrite=False)
    save_run(tmp_path / "b.h5", sample_run(), overwrite=False)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_existing_file_needs_overwrite(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        save_run(path, sample_run(), overwrite=False)
    assert path.read_text() == "mine"
    save_run(path, sample_run(), overwrite=True)
    assert len(load_run(path).frames) == 4


def test_truncated_and_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    save_run(path, sample_run(), overwrite=False)
    data = path.read_bytes()
    for name, content in (
        ("half.h5", data[: len(data) // 2]),
        ("text.h5", b"hello"),
        ("no.h5", b""),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            load_run(tmp_path / name)
    with pytest.raises(InputError, match=r"missing\.h5"):
        load_run(tmp_path / "missing.h5")


@pytest.mark.parametrize(
    ("attribute", "value", "text"),
    [("schema_version", 99, "newer lfnav"), ("format", np.bytes_("lfnav scene"), "lfnav scene")],
)
def test_another_schema_or_format_is_refused(
    tmp_path: Path, attribute: str, value: object, text: str
) -> None:
    path = tmp_path / "run.h5"
    save_run(path, sample_run(), overwrite=False)
    with h5py.File(path, "r+") as file:
        file.attrs[attribute] = value
    with pytest.raises(InputError, match=text):
        load_run(path)


@pytest.mark.parametrize(
    ("name", "change", "text"),
    [
        ("frames/0001/log_weights", lambda values: values + 1.0, "add up to"),
        ("frames/0001/log_weights", lambda values: values * np.nan, "add up to"),
        ("frames/0001/particles", lambda values: values * np.nan, "not finite"),
        ("frames/0001/particles", lambda values: values[:5], "log-weights of shape"),
        ("frames/0002/estimates/mode", lambda values: values * np.inf, "not finite"),
        ("frames/0002/covariance", lambda values: values[:2], "shape"),
        ("frames/0003/frame", lambda values: values[:20], "damaged"),
        ("odometry", lambda values: values[:1], "shape"),
    ],
)
def test_values_that_make_no_sense_are_refused(
    tmp_path: Path, name: str, change: object, text: str
) -> None:
    from pipelines.artifacts.safe_hdf5 import write_array

    assert callable(change)
    path = tmp_path / "run.h5"
    save_run(path, sample_run(), overwrite=False)
    with h5py.File(path, "r+") as file:
        values = file[name][()]
        del file[name]
        write_array(file, name, change(values))
    with pytest.raises(InputError, match=text) as caught:
        load_run(path)
    assert "run.h5" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["run", "base_from_camera", "frames/0000/image", "frames/0002"])
def test_missing_parts_are_named(tmp_path: Path, name: str) -> None:
    path = tmp_path / "run.h5"
    save_run(path, sample_run(), overwrite=False)
    with h5py.File(path, "r+") as file:
        del file[name]
    with pytest.raises(InputError, match=r"missing|declares 4 frames, has 3"):
        load_run(path)


def test_header_of_another_structure_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    headers: list[Any] = [[], {"frames": 4}, {"frames": 4, "camera": 3}, {"frames": 10**400}, 5]
    for header in headers:
        save_run(path, sample_run(), overwrite=True)
        with h5py.File(path, "r+") as file:
            del file["run"]
            write_json(file, "run", header)
        with pytest.raises(InputError, match=r"run\.h5"):
            load_run(path)


def test_a_run_of_another_scene_is_refused() -> None:
    run = sample_run()
    check_run_belongs_to(run, run.scene_identifier, "run.h5", "scene.h5")
    with pytest.raises(InputError, match=r"run\.h5: belongs to another scene than other\.h5"):
        check_run_belongs_to(run, "somethingelse", "run.h5", "other.h5")


def test_run_and_scene_can_move_together(tmp_path: Path) -> None:
    run_path = tmp_path / "runs" / "run.h5"
    scene_path = tmp_path / "scenes" / "scene.h5"
    relative = relative_scene_path(scene_path, run_path)
    assert relative == "../scenes/scene.h5"
    moved = tmp_path / "elsewhere"
    run = replace(sample_run(), scene_path=relative)
    assert locate_scene(run, moved / "runs" / "run.h5") == moved / "scenes" / "scene.h5"
    run = replace(run, scene_path=str(scene_path))
    assert locate_scene(run, moved / "runs" / "run.h5") == scene_path


def test_estimates_of_lost_frames_are_nan_and_unknown_names_refused() -> None:
    states = curved_path(3)
    states[1] = np.nan
    run = run_along(states)
    np.testing.assert_array_equal(run.estimated_states(), states)
    np.testing.assert_array_equal(run.estimated_states("max_weight"), states + 0.01)
    with pytest.raises(OptionError, match="'best'; it has max_weight, mode"):
        run.estimated_states("best")


def test_the_mode_stands_in_for_a_missing_alignment_and_only_where_nobody_asked_by_name() -> None:
    states = curved_path(3)
    run = run_along(states)
    aligned = replace(
        run.frames[1], estimates={**run.frames[1].estimates, "refined": states[1] + 0.5}
    )
    run = replace(run, frames=(run.frames[0], aligned, run.frames[2]))
    expected = np.stack([states[0], states[1] + 0.5, states[2]])
    np.testing.assert_array_equal(run.estimated_states(), expected)
    asked = run.estimated_states("refined")
    assert np.isnan(asked[[0, 2]]).all()
    np.testing.assert_array_equal(asked[1], expected[1])


def test_the_estimate_of_the_settings_stands_for_the_run() -> None:
    run = run_along(curved_path(3))
    assert run.default_estimate == "mode"
    assert replace(run, settings={"estimate": "max_weight"}).default_estimate == "max_weight"
    lost = replace(run, frames=(frame_record(0.0, {}),), encoded_images=(b"",))
    with pytest.raises(OptionError, match="lost"):
        _ = lost.default_estimate


def test_a_run_that_contradicts_itself_cannot_be_made() -> None:
    run = sample_run()
    with pytest.raises(OptionError, match="no frames"):
        replace(run, frames=(), encoded_images=())
    with pytest.raises(OptionError, match="3 images"):
        replace(run, encoded_images=run.encoded_images[:3])
    with pytest.raises(OptionError, match="increase"):
        replace(run, frames=run.frames[::-1])
    with pytest.raises(OptionError, match="status"):
        replace(run.frames[0], status="happy")
    with pytest.raises(OptionError, match="confidence"):
        replace(run.frames[0], confidence=float("nan"))
    with pytest.raises(StageError, match="add up"):
        replace(run.frames[0], log_weights=run.frames[0].log_weights + 1.0)


# --- six degrees of freedom, and the files of older versions ----------------------------------


def test_a_spatial_run_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    run = spatial_run(3)
    save_run(tmp_path / "run.h5", run, overwrite=False)
    loaded = load_run(tmp_path / "run.h5")
    assert loaded.space.name == "spatial"
    for read, written in zip(loaded.frames, run.frames, strict=True):
        for name in ("particles", "log_weights", "modes", "covariance", "refined_covariance"):
            np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
        assert set(read.estimates) == set(written.estimates)
    np.testing.assert_array_equal(loaded.estimated_states(), run.estimated_states())
    assert loaded.odometry is not None
    assert run.odometry is not None
    np.testing.assert_array_equal(loaded.odometry, run.odometry)


def test_the_refined_estimate_stands_for_a_run_that_has_one() -> None:
    run = spatial_run(2)
    assert run.default_estimate == "refined"
    assert replace(run, settings={"estimate": "mode"}).default_estimate == "mode"


def test_frames_of_different_degrees_of_freedom_are_no_run() -> None:
    spatial, planar = spatial_run(2), run_along(curved_path(2))
    with pytest.raises(OptionError, match="degrees of freedom"):
        replace(spatial, frames=(spatial.frames[0], planar.frames[1]), odometry=None)
    with pytest.raises(OptionError, match="odometry of shape"):
        replace(spatial, odometry=np.zeros((2, 3)))
    with pytest.raises(OptionError, match="estimate mode of shape"):
        replace(spatial.frames[0], estimates={"mode": np.zeros(3)})
    with pytest.raises(OptionError, match="covariance of refined"):
        replace(spatial.frames[0], refined_covariance=np.eye(3))


def test_files_of_schema_one_are_still_read(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    run = sample_run()
    save_run(path, run, overwrite=False)
    with h5py.File(path, "r+") as file:
        # As version 1 wrote it: no degrees of freedom, no covariance of an alignment.
        file.attrs["schema_version"] = 1
        for index in range(4):
            name = f"frames/{index:04d}/frame"
            header = json.loads(file[name][()].tobytes())
            del header["degrees_of_freedom"]
            assert "refined_covariance" not in file[f"frames/{index:04d}"]
            del file[name]
            write_json(file, name, header)
    loaded = load_run(path)
    assert loaded.space.name == "planar"
    np.testing.assert_array_equal(loaded.estimated_states(), run.estimated_states())


@pytest.mark.parametrize("dimension", [0, 2, 4, 10**9, -3, "many"])
def test_impossible_degrees_of_freedom_are_refused(tmp_path: Path, dimension: object) -> None:
    path = tmp_path / "run.h5"
    save_run(path, sample_run(), overwrite=False)
    with h5py.File(path, "r+") as file:
        header = json.loads(file["frames/0001/frame"][()].tobytes())
        header["degrees_of_freedom"] = dimension
        del file["frames/0001/frame"]
        write_json(file, "frames/0001/frame", header)
    with pytest.raises(InputError, match=r"run\.h5"):
        load_run(path)


def test_settings_of_earlier_versions_get_their_present_names(tmp_path: Path) -> None:
    former = {
        "strategy": "informed",
        "proposal": "appearance",
        "with_pnp": True,
        "start": [1.0, 2.0, 0.5],
        "likelihood": {"cost": "zncc", "sharpness": 60.0, "one_pixel_in": 5},
    }
    run = replace(sample_run(), settings=former)
    save_run(tmp_path / "run.h5", run, overwrite=False)
    loaded = load_run(tmp_path / "run.h5")
    assert loaded.settings == {
        "strategy": "mixture",
        "proposal": "retrieval",
        "with_pnp": True,
        "start": [1.0, 2.0, 0.5],
        "likelihood": {"cost": "zncc", "inverse_temperature": 60.0, "pixel_subsampling": 5},
    }
