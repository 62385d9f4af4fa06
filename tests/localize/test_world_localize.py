"""Localizing in a world of two rooms: areas are opened, belief knows them, doors are no borders."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dataset.images import decode_image
from pipelines.lightfield.depth_storage import Depths
from pipelines.lightfield.open_world import OpenWorld, open_world
from pipelines.localize import area_search
from pipelines.localize.evaluation import evaluate_run
from pipelines.localize.run import Run, load_run
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.stage import LocalizeRequest, localize
from pipelines.render import area_renderers
from pipelines.render.area_renderers import AreaRenderers
from pipelines.render.choices import Blending, Channels, Quality
from pipelines.report.stage import ReportSettings, report
from tests.chain_samples import lfnav
from tests.lightfield_samples import looking
from tests.world_drive_samples import drive, seen, through_the_door, world_of_rooms
from tests.world_samples import TWO_ROOMS

SETTINGS = LocalizerSettings(start_particles=1500)
WEST_ONLY = TWO_ROOMS[: TWO_ROOMS.index("[[area]]", 10)]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The world, one of the western room alone, and a drive through both."""
    folder = tmp_path_factory.mktemp("rooms")
    world_of_rooms(folder)
    world_of_rooms(folder, WEST_ONLY, "west")
    drive(folder / "drive", through_the_door())
    return folder


@pytest.fixture(scope="module")
def run(place: Path) -> Run:
    localize(LocalizeRequest(place / "world", place / "drive", place / "run.h5", SETTINGS))
    return load_run(place / "run.h5")


def test_a_robot_is_followed_through_the_door(run: Run) -> None:
    assert {frame.status for frame in run.frames[3:]} == {"tracking"}
    found = evaluate_run(run)
    assert found.success
    assert found.errors.position_error_m.per_frame[3:].max() < 0.05
    assert found.areas is not None
    assert found.areas.borders == 1
    assert found.areas.right_share == 1.0
    assert found.areas.lost_at_borders == 0
    assert found.areas.largest_jump is not None
    assert found.areas.largest_jump < 0.03


def test_the_belief_over_areas_is_that_of_the_particles(run: Run) -> None:
    assert run.areas is not None
    assert run.areas.names == ("west", "east")
    for frame in run.frames:
        assert frame.area_belief is not None
        west = float(frame.belief.weights[frame.particles[:, 0] < 0.0].sum())
        inside = float(frame.area_belief.sum())
        # The rooms' border is between the photos next to it, 0.4 m apart in the doorway.
        near = np.abs(frame.particles[:, 0]) < 0.2
        slack = float(frame.belief.weights[near].sum()) + 1e-9
        assert frame.area_belief[0] == pytest.approx(inside * west, abs=slack)
        assert 0.9 < inside <= 1.0


def test_the_same_seed_gives_the_same_run(place: Path, run: Run, tmp_path: Path) -> None:
    localize(LocalizeRequest(place / "world", place / "drive", tmp_path / "run.h5", SETTINGS))
    again = load_run(tmp_path / "run.h5")
    for frame, other in zip(run.frames, again.frames, strict=True):
        np.testing.assert_array_equal(frame.particles, other.particles)
        np.testing.assert_array_equal(frame.log_weights, other.log_weights)


def test_little_memory_opens_one_area_after_the_other(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(area_renderers, "BESIDE_VIEWS", 0.0)
    world = open_world(place / "world")
    largest = max(len(area.views) for area in world.index.areas)
    both = len({view for area in world.index.areas for view in area.views.tolist()})
    of_view = 0.0716
    memory = (largest + 10) * of_view
    assert memory < both * of_view
    request = LocalizeRequest(
        place / "world", place / "drive", tmp_path / "run.h5", SETTINGS, memory=memory
    )
    localize(request)
    found = evaluate_run(load_run(tmp_path / "run.h5"))
    assert found.success
    assert found.areas is not None
    assert found.areas.right_share_later == 1.0
    with pytest.raises(
        OptionError, match=r"--memory 1 is too small for area east and its \d+ views"
    ):
        localize(replace(request, memory=1.0, overwrite=True))


def test_areas_that_were_not_needed_for_longest_are_closed(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(area_renderers, "BESIDE_VIEWS", 0.0)
    world = open_world(place / "world")
    world = replace(world, memory=150 * 0.0716)
    opened = AreaRenderers(world, 96, (Channels.COLOUR,), Blending.UNSTRUCTURED, Quality.COARSE, 1)
    assert opened.need([0])
    assert opened.open_areas == (0,)
    assert not opened.need([0])
    assert opened.need([1])
    assert opened.open_areas == (1,)


def test_a_world_that_fits_is_read_once_and_shown_where_it_is_needed(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = open_world(place / "world")
    opened = AreaRenderers(world, 96, (Channels.COLOUR,), Blending.UNSTRUCTURED, Quality.COARSE, 1)
    assert opened.fits_as_a_whole
    opened.open_all()
    open_areas = [opened.open_areas]
    together = opened.renderers[Channels.COLOUR].views
    assert len(together) == len(world.index.image_names)
    # Where nothing is needed nothing is closed.
    assert not opened.need([])

    def fail(*_: object) -> Iterator[Any]:
        raise AssertionError("a photo was read again")

    monkeypatch.setattr(OpenWorld, "scenes", fail)
    assert opened.need([0])
    alone = opened.renderers[Channels.COLOUR].views
    photos = world.index.areas[0].views
    np.testing.assert_array_equal(alone.centres, together.centres[photos])
    for number, photo in enumerate(photos.tolist()):
        # Also those that are at home in the other area.
        np.testing.assert_array_equal(alone.depth_map(number), together.depth_map(photo))
    assert opened.need([1])
    # At a border an area that was just needed may be needed again.
    open_areas.append(opened.open_areas)
    changes = [opened.need([1]) for _ in range(area_renderers.KEPT_OPEN)]
    assert changes.count(True) == 1
    assert [*open_areas, opened.open_areas] == [(0, 1), (0, 1), (1,)]


def test_what_was_read_ahead_is_not_read_again(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = open_world(place / "world")
    opened = AreaRenderers(world, 96, (Channels.COLOUR,), Blending.UNSTRUCTURED, Quality.COARSE, 1)
    opened.need([0], soon=[0, 1])
    assert opened.open_areas == (0,)
    opened.finish_reading()
    read: list[int] = []
    scenes = OpenWorld.scenes

    def noted(self: OpenWorld, area: int, photos: Sequence[int], depths: Depths) -> Iterator[Any]:
        read.extend(photos)
        return scenes(self, area, photos, depths)

    monkeypatch.setattr(OpenWorld, "scenes", noted)
    opened.need([0, 1])
    assert len(opened.renderers[Channels.COLOUR].views) == len(world.index.image_names)
    # Photos of both areas have no second place while that of the first is shown.
    west, east = (set(area.views.tolist()) for area in world.index.areas)
    assert set(read) <= west & east


def test_no_area_is_closed_for_one_that_is_read_ahead(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(area_renderers, "BESIDE_VIEWS", 0.0)
    world = replace(open_world(place / "world"), memory=150 * 0.0716)
    opened = AreaRenderers(world, 96, (Channels.COLOUR,), Blending.UNSTRUCTURED, Quality.COARSE, 1)
    open_areas = []
    for needed, soon in ((0, 1), (0, 1), (1, 0)):
        # Both do not fit: what is needed now is not closed for what may be needed.
        opened.need([needed], soon=[soon])
        open_areas.append(opened.open_areas)
    assert open_areas == [(0,), (0,), (1,)]


def test_both_rooms_open_are_one_light_field(place: Path) -> None:
    world = open_world(place / "world")
    opened = AreaRenderers(world, 96, (Channels.COLOUR,), Blending.UNSTRUCTURED, Quality.COARSE, 1)
    opened.need([1, 0])
    views = opened.renderers[Channels.COLOUR].views
    assert len(views) == len(world.index.image_names)
    np.testing.assert_array_equal(views.centres, world.world_from_camera[:, :3, 3])
    for photo in (0, len(views) - 1):
        area = int(world.index.home[photo])
        _, scene = next(world.scenes(area, [photo]))
        np.testing.assert_array_equal(views.level(photo, 0), scene.image(0))
        np.testing.assert_array_equal(views.depth_map(photo), scene.depth[0].inverse_depth)


def test_a_robot_in_a_room_that_is_not_in_the_world_is_not_tracked(
    place: Path, tmp_path: Path
) -> None:
    beyond = through_the_door()[:10] + np.array([8.0, 0.0, 0.3])
    data = drive(tmp_path / "drive", beyond)
    localize(LocalizeRequest(place / "world", data, tmp_path / "run.h5", SETTINGS))
    statuses = [frame.status for frame in load_run(tmp_path / "run.h5").frames]
    assert "tracking" not in statuses


def test_an_area_without_its_file_is_named(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "world", tmp_path / "world")
    (tmp_path / "world/areas/east.h5").unlink()
    told = lfnav("localize", tmp_path / "world", place / "drive", "-o", tmp_path / "run.h5")
    assert told.code != 0
    assert "east.h5 is missing" in told.err.replace(": ", " ")
    assert len(told.err.strip().splitlines()) == 1
    assert not (tmp_path / "run.h5").exists()


def test_an_area_of_another_build_is_named(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "world", tmp_path / "world")
    shutil.copy(place / "west/areas/west.h5", tmp_path / "world/areas/east.h5")
    with pytest.raises(InputError, match="belongs to another build of the world"):
        open_world(tmp_path / "world")


def test_a_world_of_a_newer_schema_is_refused(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "world", tmp_path / "world")
    with h5py.File(tmp_path / "world/world.h5", "r+") as file:
        file.attrs["schema_version"] = np.int64(99)
    with pytest.raises(InputError, match=r"world\.h5"):
        open_world(tmp_path / "world")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--strategy", "condensation"), "a world takes strategy mixture, not condensation"),
        (("--method", "pnp"), "PnP takes the features of one scene"),
        (("--memory", "-3"), "--memory"),
    ],
)
def test_what_a_world_does_not_take_is_refused(
    place: Path, tmp_path: Path, options: tuple[str, str], message: str
) -> None:
    told = lfnav("localize", place / "world", place / "drive", "-o", tmp_path / "run.h5", *options)
    assert told.code != 0
    assert message in told.err
    assert not (tmp_path / "run.h5").exists()


def test_memory_is_of_worlds(place: Path, tmp_path: Path) -> None:
    scene = place / "world/areas/west.h5"
    with pytest.raises(OptionError, match="a scene is one piece"):
        localize(
            LocalizeRequest(scene, place / "drive", tmp_path / "run.h5", SETTINGS, memory=100.0)
        )


def test_old_runs_have_no_areas(place: Path, tmp_path: Path) -> None:
    scene = place / "world/areas/west.h5"
    localize(LocalizeRequest(scene, place / "drive", tmp_path / "run.h5", SETTINGS))
    run = load_run(tmp_path / "run.h5")
    assert run.areas is None
    assert all(frame.area_belief is None for frame in run.frames)
    assert evaluate_run(run).areas is None
    assert area_search.MOST_AREAS >= area_search.LEAST_AREAS


def test_a_report_shows_the_areas(place: Path, run: Run, tmp_path: Path) -> None:
    assert run.areas is not None
    written = report(place / "run.h5", tmp_path / "report", ReportSettings(frames=(0,)))
    assert "figures/overview.png" in written.files
    page = (tmp_path / "report/report.html").read_text(encoding="utf-8")
    assert "world of 2 areas, 224 photos" in page


def test_on_a_border_both_areas_are_right(run: Run) -> None:
    assert run.areas is not None
    there = run.areas.borders(np.array([[-2.0, 0.0], [0.0, 0.0], [2.0, 0.0]]), 0.1)
    assert there.tolist() == [[True, False], [True, True], [False, True]]


def test_views_of_a_world_are_rendered(place: Path, tmp_path: Path) -> None:
    options = ("-o", tmp_path / "view.png", "--pose", "1.5,0.2,20")
    assert lfnav("render", place / "world", *options).code == 0
    shown = decode_image((tmp_path / "view.png").read_bytes(), "view.png")
    camera = np.array(
        looking([1.5, 0.2, 1.0], [1.5 + np.cos(np.radians(20)), 0.2 + np.sin(np.radians(20)), 1.0])
    )
    error = np.abs(shown.astype(np.float64) - seen(camera)[0])
    assert np.median(error) < 10.0
