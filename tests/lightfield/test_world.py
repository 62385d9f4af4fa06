"""A world is built whole or not at all, resumed, the same each time, and read with suspicion."""

import json
import multiprocessing
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.artifacts.provenance import sha256_of_file
from pipelines.lightfield import area_build
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.lightfield.stage import ModelSettings, build_scene
from pipelines.lightfield.world import AreaSettings, model_world
from pipelines.lightfield.world_file import load_recognition, load_world
from pipelines.reconstruct.reconstruction import Reconstruction
from tests.chain_samples import lfnav, succeed
from tests.world_samples import FLOOR, TWO_ROOMS, room_places, rooms_reconstruction

FLAT = ModelSettings(plane=(0.0, 0.0, 1.0, 0.0))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``map`` and ``areas.toml`` of the two rooms, and the world made of them."""
    folder = tmp_path_factory.mktemp("rooms")
    rooms_reconstruction(folder)
    (folder / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    options = ("--areas", folder / "areas.toml", "--plane", FLOOR)
    succeed("model", folder / "map", "-o", folder / "world", *options)
    return folder


@pytest.fixture
def drawn(place: Path) -> AreaSettings:
    return AreaSettings(file=place / "areas.toml")


def content(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): sha256_of_file(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_each_area_is_an_ordinary_scene_with_its_photos(place: Path) -> None:
    world = load_world(place / "world")
    assert [area.name for area in world.areas] == ["west", "east"]
    for area, other in zip(world.areas, reversed(world.areas), strict=True):
        scene = load_scene(place / f"world/areas/{area.name}.h5")
        assert scene.image_names == tuple(world.image_names[view] for view in area.views)
        np.testing.assert_array_equal(scene.world_from_camera, world.world_from_camera[area.views])
        assert area.identifier == scene.identifier
        assert area.sha256 == sha256_of_file(place / f"world/areas/{area.name}.h5")
        assert area.neighbours == (other.name,)
        own = world.home[area.views] == [a.name for a in world.areas].index(area.name)
        assert own.sum() == 112
        assert np.count_nonzero(~own) > 0


def test_the_index_holds_the_graph_of_recorded_positions(place: Path) -> None:
    world = load_world(place / "world")
    ends = world.world_from_camera[world.links, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1), world.link_lengths)
    crossing = ends[np.prod(ends[..., 0], axis=1) < 0.0]
    assert len(crossing) > 0
    assert np.abs(crossing.mean(axis=1)[:, 1]).max() <= 0.5


def test_the_same_world_is_the_same_bytes(place: Path, drawn: AreaSettings, tmp_path: Path) -> None:
    model_world(place / "map", tmp_path / "world", drawn, FLAT)
    assert content(tmp_path / "world") == content(place / "world")
    assert list(tmp_path.iterdir()) == [tmp_path / "world"]


def test_several_processes_build_the_same_bytes(place: Path, tmp_path: Path) -> None:
    settings = AreaSettings(file=place / "areas.toml", jobs=2)
    model_world(place / "map", tmp_path / "world", settings, FLAT)
    assert content(tmp_path / "world") == content(place / "world")


def test_finished_areas_are_not_built_again(
    place: Path, drawn: AreaSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []

    def failing(source: Reconstruction, *arguments: Any) -> Scene:
        built.append(source.image_names[0])
        if len(built) == 2:
            raise StageError("the lights went out")
        return build_scene(source, *arguments)

    monkeypatch.setattr(area_build, "build_scene", failing)
    with pytest.raises(StageError, match="area east: the lights went out"):
        model_world(place / "map", tmp_path / "world", drawn, FLAT)
    assert not (tmp_path / "world").exists()
    building = tmp_path / "world.areas-in-progress"
    assert "is a world that is being built" in lfnav("info", building).err
    kept = list(building.iterdir())
    assert {path.name.split(".")[0] for path in kept} == {"west"}
    model_world(place / "map", tmp_path / "world", drawn, FLAT)
    assert len(built) == 3
    assert content(tmp_path / "world") == content(place / "world")
    assert list(tmp_path.iterdir()) == [tmp_path / "world"]


def test_damaged_and_outdated_finished_areas_are_built_again(
    place: Path, drawn: AreaSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise StageError("stop")

    with monkeypatch.context() as patch:
        patch.setattr("pipelines.lightfield.world.atomic_folder", refuse)
        with pytest.raises(StageError, match="stop"):
            model_world(place / "map", tmp_path / "world", drawn, FLAT)
    kept = sorted((tmp_path / "world.areas-in-progress").iterdir())
    # Of each area its scene and its features.
    assert len(kept) == 4
    for path in kept[:3]:
        path.write_bytes(path.read_bytes()[:1000])
    other = ModelSettings(plane=(0.0, 0.0, 1.0, 0.1))
    model_world(place / "map", tmp_path / "other", drawn, other)
    model_world(place / "map", tmp_path / "world", drawn, FLAT)
    assert content(tmp_path / "world") == content(place / "world")
    assert content(tmp_path / "other") != content(place / "world")


def test_a_killed_build_goes_on(place: Path, tmp_path: Path) -> None:
    output = tmp_path / "world"
    command: list[str | Path] = [
        sys.executable,
        "-m",
        "lfnav_cli.main",
        "model",
        place / "map",
        "-o",
        output,
    ]
    command += ["--areas", place / "areas.toml", "--plane", FLOOR]
    process = subprocess.Popen(command)
    building = tmp_path / "world.areas-in-progress"
    until = time.monotonic() + 60.0
    while process.poll() is None and not any(building.glob("west.*.h5")):
        assert time.monotonic() < until
        time.sleep(0.001)
    process.kill()
    process.wait()
    # On a fast machine it may have been too late for killing.
    assert list(building.glob("west.*.h5")) or output.is_dir()
    drawn = AreaSettings(file=place / "areas.toml")
    model_world(place / "map", output, drawn, FLAT, overwrite=True)
    assert content(output) == content(place / "world")


def test_a_process_that_is_killed_costs_its_area(place: Path, tmp_path: Path) -> None:
    settings = AreaSettings(file=place / "areas.toml", jobs=2)

    def kill_one() -> None:
        # Whoever has just been started is still importing.
        while not (children := multiprocessing.active_children()):
            time.sleep(0.01)
        children[0].kill()

    killer = threading.Thread(target=kill_one)
    killer.start()
    with pytest.raises(StageError, match=r"finished areas are kept, missing are .*east"):
        model_world(place / "map", tmp_path / "world", settings, FLAT)
    killer.join()
    assert not (tmp_path / "world").exists()
    model_world(place / "map", tmp_path / "world", settings, FLAT)
    assert content(tmp_path / "world") == content(place / "world")


def test_max_views_holds_for_each_area(place: Path, drawn: AreaSettings, tmp_path: Path) -> None:
    few = ModelSettings(plane=(0.0, 0.0, 1.0, 0.0), max_views=20)
    summary = model_world(place / "map", tmp_path / "world", drawn, few)
    assert [len(area.views) for area in summary.world.areas] == [20, 20]
    assert len(load_world(tmp_path / "world").image_names) == 224
    assert summary.to_dict()["areas"][0]["own_views"] == 112


def test_depth_maps_are_made_in_each_area(tmp_path: Path) -> None:
    places = [(x, 0.0) for x in (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0)]
    rooms_reconstruction(tmp_path, places)
    (tmp_path / "areas.toml").write_text(TWO_ROOMS, encoding="utf-8")
    settings = ModelSettings(geometry="depth", plane=(0.0, 0.0, 1.0, 0.0))
    areas = AreaSettings(file=tmp_path / "areas.toml")
    summary = model_world(tmp_path / "map", tmp_path / "world", areas, settings)
    for area in summary.world.areas:
        scene = load_scene(tmp_path / f"world/areas/{area.name}.h5")
        assert len(scene.depth) == len(scene) == len(area.views)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["areas.toml", "data", "map", "world"]


def test_memory_bounds_the_photos_of_an_area(place: Path, tmp_path: Path) -> None:
    of_one = 48 * 36 * 4
    settings = AreaSettings(megabytes=160 * of_one / 1e6)
    summary = model_world(place / "map", tmp_path / "world", settings, FLAT)
    assert len(summary.world.areas) >= 2
    # In memory a photo also takes its file and a pyramid of smaller ones.
    assert all(len(area.views) < 160 for area in summary.world.areas)
    assert all(area.memory_bytes < 1.1 * 160 * of_one for area in summary.world.areas)


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"views": 7}, "--area-views 7 is less than 8"),
        ({"views": -3}, "--area-views -3 is less than 8"),
        ({"megabytes": -1.0}, "--area-memory -1 is not between"),
        ({"megabytes": float("nan")}, "--area-memory nan is not between"),
        ({"views": 100, "megabytes": 10.0}, "exclude each other"),
        ({"file": Path("a.toml"), "views": 100}, "go with --areas auto"),
        ({"jobs": 0}, "--jobs 0 is not between"),
        ({"jobs": 2, "scheduler": "tcp://127.0.0.1:1"}, "--jobs is for this machine"),
    ],
)
def test_silly_settings_are_refused(options: dict[str, object], reason: str) -> None:
    with pytest.raises(OptionError, match=reason):
        AreaSettings(**options)  # type: ignore[arg-type]


def test_memory_for_no_area_is_refused(place: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="holds 0 of these photos; an area needs room for 8"):
        model_world(place / "map", tmp_path / "world", AreaSettings(megabytes=0.01), FLAT)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_world_is_replaced_on_request_only(
    place: Path, drawn: AreaSettings, tmp_path: Path
) -> None:
    output = tmp_path / "world"
    shutil.copytree(place / "world", output)
    with pytest.raises(InputError, match="exists already; use --overwrite"):
        model_world(place / "map", output, drawn, FLAT)
    other = ModelSettings(plane=(0.0, 0.0, 1.0, 0.1))
    model_world(place / "map", output, drawn, other, overwrite=True)
    assert content(output) != content(place / "world")
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="will not be overwritten"):
        model_world(place / "map", foreign, drawn, FLAT, overwrite=True)


def missing_area(world: Path) -> Path:
    path = world / "areas/east.h5"
    path.unlink()
    return path


def area_of_another_build(world: Path) -> Path:
    shutil.copyfile(world / "areas/west.h5", world / "areas/east.h5")
    return world / "areas/east.h5"


def area_of_a_newer_schema(world: Path) -> Path:
    path = world / "areas/east.h5"
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = np.int64(99)
    return path


def area_that_is_no_scene(world: Path) -> Path:
    (world / "areas/east.h5").write_bytes(b"nothing")
    return world / "areas/east.h5"


def half_built(world: Path) -> Path:
    (world / "world.h5").unlink()
    return world


def newer_world(world: Path) -> Path:
    with h5py.File(world / "world.h5", "r+") as file:
        file.attrs["schema_version"] = np.int64(99)
    return world / "world.h5"


def truncated_index(world: Path) -> Path:
    data = (world / "world.h5").read_bytes()
    (world / "world.h5").write_bytes(data[: len(data) // 2])
    return world / "world.h5"


def with_description(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], Path]:
    """Changes the JSON of the index."""

    def edit(world: Path) -> Path:
        path = world / "world.h5"
        with h5py.File(path, "r+") as file:
            description = json.loads(file["world"][()].tobytes())
            change(description)
            del file["world"]
            data = np.frombuffer(json.dumps(description).encode(), dtype=np.uint8)
            file.create_dataset("world", data=data, chunks=data.shape, fletcher32=True)
        return path

    return edit


def rename(name: str) -> Callable[[Path], Path]:
    return with_description(lambda d: d["areas"][0].update(name=name))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (missing_area, "is missing: the world is not whole"),
        (area_of_another_build, "belongs to another build of the world"),
        (area_of_a_newer_schema, "was written by a newer lfnav"),
        (area_that_is_no_scene, "is not an HDF5 file"),
        (half_built, "holds areas/ and no world.h5: the world is not whole"),
        (newer_world, "was written by a newer lfnav"),
        (truncated_index, "is damaged or truncated"),
        (rename("../../etc/passwd"), "cannot be that of a file"),
        (rename("east"), "names an area twice"),
        (rename("north"), "names a neighbour that there is not"),
        (with_description(lambda d: d.pop("areas")), "areas is missing"),
        (with_description(lambda d: d.update(areas=[])), "holds no areas or no photos"),
        (with_description(lambda d: d.update(identifier="0")), "was changed after it was written"),
        (
            with_description(lambda d: d["areas"][0].update(rectangle=[1, 0, 0, 1])),
            "rectangle encloses no area",
        ),
    ],
)
def test_spoilt_worlds_are_refused_in_one_line(
    place: Path, tmp_path: Path, spoil: Callable[[Path], Path], reason: str
) -> None:
    world = tmp_path / "world"
    shutil.copytree(place / "world", world)
    named = spoil(world)
    outcome = lfnav("info", world)
    assert outcome.code == 1
    assert outcome.out == ""
    assert outcome.err.startswith(f"lfnav: {named}: ")
    assert reason in outcome.err
    assert outcome.err.count("\n") == 1


def test_a_link_that_leads_nowhere_is_refused(place: Path, tmp_path: Path) -> None:
    world = tmp_path / "world"
    shutil.copytree(place / "world", world)
    with h5py.File(world / "world.h5", "r+") as file:
        file["links"][0, 0] = 10**6
    with pytest.raises(InputError, match="links names something that it does not hold"):
        load_world(world)


def test_a_world_of_schema_1_is_read_and_says_how_to_mend_it(place: Path, tmp_path: Path) -> None:
    old = tmp_path / "world"
    shutil.copytree(place / "world", old)
    with h5py.File(old / "world.h5", "r+") as file:
        del file["retrieval"]
        file.attrs["schema_version"] = 1
    world = load_world(old)
    assert world.identifier == load_world(place / "world").identifier
    assert json.loads(succeed("info", old, "--json"))["retrieval_bytes"] == 0
    with pytest.raises(InputError, match="make the world again with lfnav model --areas"):
        load_recognition(old, world)


# --- the command line ----------------------------------------------------------------------------


def test_info_prints_the_areas(place: Path) -> None:
    text = succeed("info", place / "world")
    assert text.splitlines()[0].split()[:3] == ["area", "own", "views"]
    assert "west" in text
    assert "2 areas" in text
    facts = json.loads(succeed("info", place / "world", "--json"))
    assert facts["kind"] == "world"
    assert facts["photos"] == 224
    assert [area["neighbours"] for area in facts["areas"]] == [["east"], ["west"]]
    assert facts["areas"][0]["rectangle_m"] == [-4.0, 0.0, -2.0, 2.0]
    assert 0 < facts["retrieval_bytes"] < (place / "world" / "world.h5").stat().st_size
    size = f"{facts['retrieval_bytes'] / 1e6:.1f}"
    assert text.splitlines()[-1].split() == ["retrieval", "index", size, "MB"]


def test_info_draws_the_areas(place: Path, tmp_path: Path) -> None:
    picture = tmp_path / "areas.png"
    succeed("info", place / "world", "--picture", picture)
    first = picture.read_bytes()
    assert first.startswith(b"\x89PNG")
    assert "exists already" in lfnav("info", place / "world", "--picture", picture).err
    succeed("info", place / "world", "--picture", picture, "--overwrite")
    assert picture.read_bytes() == first
    outcome = lfnav("info", place / "map", "--picture", tmp_path / "map.png")
    assert outcome.code == 2
    assert not (tmp_path / "map.png").exists()


def test_what_takes_one_scene_says_so(place: Path) -> None:
    world = place / "world"
    outcome = lfnav("evaluate", world, "--leave-one-out")
    assert outcome.code == 1
    assert outcome.err == (
        f"lfnav: {world}: is a world of areas, which this command does not take yet; "
        f"name the scene of one area, {world}/areas/NAME.h5\n"
    )


@pytest.mark.parametrize(
    "option", [("--area-views", "100"), ("--jobs", "2"), ("--scheduler", "tcp://127.0.0.1:1")]
)
def test_options_of_worlds_need_areas(place: Path, tmp_path: Path, option: tuple[str, str]) -> None:
    outcome = lfnav("model", place / "map", "-o", tmp_path / "scene.h5", *option)
    assert outcome.code == 2
    assert f"{option[0]} goes with --areas" in outcome.err


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (TWO_ROOMS.replace("xmin = -4", "xmin = 1"), "xmin 1 is not below xmax 0"),
        (TWO_ROOMS.replace('"east"', '"a/b"'), "cannot be that of a file"),
        (TWO_ROOMS + '[[area]]\nname = "n"\nxmin=0\nxmax=1\nymin=8\nymax=9', "'n' holds no photo"),
    ],
)
def test_bad_files_of_areas_leave_nothing(
    place: Path, tmp_path: Path, text: str, reason: str
) -> None:
    drawn = tmp_path / "areas.toml"
    drawn.write_text(text, encoding="utf-8")
    outcome = lfnav("model", place / "map", "-o", tmp_path / "world", "--areas", drawn)
    assert outcome.code == 1
    assert outcome.err.startswith(f"lfnav: {drawn}: ")
    assert reason in outcome.err
    assert list(tmp_path.iterdir()) == [drawn]


def test_a_map_of_one_room_is_a_world_of_one_area(tmp_path: Path) -> None:
    rooms_reconstruction(tmp_path, room_places(-2.0)[::2])
    text = succeed(
        "model", tmp_path / "map", "-o", tmp_path / "world", "--areas", "auto", "--plane", FLOOR
    )
    assert "area-01" in text
    assert "1 areas" not in text


def test_photos_outside_of_all_areas_are_named(place: Path, tmp_path: Path) -> None:
    west = TWO_ROOMS.split("[[area]]")[1]
    (tmp_path / "west.toml").write_text("[[area]]" + west, encoding="utf-8")
    options = ("--areas", tmp_path / "west.toml", "--plane", FLOOR)
    outcome = lfnav("model", place / "map", "-o", tmp_path / "world", *options)
    assert outcome.code == 0
    left_out = np.count_nonzero(load_world(tmp_path / "world").home < 0)
    assert left_out > 0
    assert f"{left_out} of 224 photos lie outside of all areas" in outcome.err
