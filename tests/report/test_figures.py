"""The parts of the figures: what lies where, what is marked, what must not overlap."""

import io
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from PIL import Image

from pipelines.artifacts.arrays import BoolArray, ImageArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import base_from_camera_mount, world_from_base_planar
from pipelines.localize.run import FrameRecord, Run
from pipelines.render.renderer import Renderer, Rendering
from pipelines.report.figures import Content, frame_figure, overview_figure, shortened
from pipelines.report.style import UNCOVERED_DARK, UNCOVERED_LIGHT, figure_style
from pipelines.report.surroundings import surface_from_above, surroundings_of
from pipelines.report.time_plots import stage_seconds, time_figure
from pipelines.report.top_view import (
    MAX_DOTS,
    _shown,
    arrow_marker,
    box_limits,
    close_up_extent,
    covariance_ellipse,
    particle_tones,
    tick_step,
)
from pipelines.report.tracks import tracks_of
from pipelines.report.views import ViewMaker, mark_uncovered, model_view
from tests.report_samples import CAMERA, MOUNT, TRUTH, WALL, facing_wall, wall_run, wall_scene


def content_of(run: Run, indices: tuple[int, ...] = (0, 3, 5)) -> Content:
    scene = wall_scene()
    tracks = tracks_of(run, None)
    renderer = Renderer.of_scene(scene)
    maker = ViewMaker(run, lambda _: renderer)
    views = {
        index: maker.views(
            index,
            tracks.estimated[index],
            None if tracks.odometry is None else tracks.odometry[index],
        )
        for index in indices
    }
    return Content(run, tracks, surroundings_of(scene, tracks), views)


@pytest.fixture(scope="module")
def content() -> Content:
    return content_of(wall_run())


def is_striped(pixels: ImageArray) -> BoolArray:
    marks = [np.all(pixels == colour, axis=-1) for colour in (UNCOVERED_DARK, UNCOVERED_LIGHT)]
    return np.asarray(np.any(marks, axis=0), dtype=np.bool_)


def test_uncovered_pixels_are_striped_and_others_untouched() -> None:
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3)).astype(np.uint8)
    covered = np.ones((60, 80), dtype=np.bool_)
    covered[10:50, 20:70] = False
    marked = mark_uncovered(image, covered)
    assert np.array_equal(marked[covered], image[covered])
    striped = marked[~covered]
    shares = [np.mean(np.all(striped == c, axis=1)) for c in (UNCOVERED_DARK, UNCOVERED_LIGHT)]
    assert sum(shares) == pytest.approx(1.0)
    assert min(shares) > 0.3
    # Both colours in every row: nowhere could it be taken for a plain area of the scene.
    rows = marked[10:50, 20:70]
    assert all(len(np.unique(row, axis=0)) == 2 for row in rows)


def test_view_past_the_end_of_the_map_is_striped_in_the_figure() -> None:
    """The map ends at x = 3; from 2 m away at x = 3, the right half of the picture is beyond."""
    run = wall_run(odometry=None)
    beyond = facing_wall(3.0, 2.0)
    frames = (replace(run.frames[0], estimates={"mode": beyond}), *run.frames[1:])
    content = content_of(replace(run, frames=frames), (0, 3))
    outside = content.views[0].at_estimate
    inside = content.views[3].at_estimate
    assert outside is not None
    assert inside is not None
    columns = outside.covered.mean(axis=0)
    assert np.all(columns[:22] == 1.0)
    assert np.all(columns[26:] == 0.0)
    assert np.array_equal(is_striped(outside.picture), ~outside.covered)
    assert inside.covered.all()
    assert not is_striped(inside.picture).any()
    with figure_style():
        pixels = drawn(overview_figure(content))
    # The striped half of one picture, and the small patch of the legend.
    dark = np.all(pixels[..., :3] == UNCOVERED_DARK, axis=-1)
    assert dark[: pixels.shape[0] // 2].sum() > 2000


def test_difference_is_that_of_covered_pixels() -> None:
    real = np.full((4, 6, 3), 100, dtype=np.uint8)
    image = real.copy()
    image[:, :3] = (110, 90, 100)
    image[:, 3:] = 0
    covered = np.zeros((4, 6), dtype=np.bool_)
    covered[:, :3] = True
    view = model_view(real, Rendering(image, covered))
    assert view.mean_difference == pytest.approx(20.0 / 3.0)
    assert np.all(np.isnan(view.difference[:, 3:]))
    nothing = model_view(real, Rendering(image, np.zeros_like(covered)))
    assert np.isnan(nothing.mean_difference)


def test_view_at_the_truth_looks_like_the_camera(content: Content) -> None:
    """The odometry of the sample is the truth moved by 7 m, so it is put back onto the truth."""
    for index, views in content.views.items():
        assert views.at_odometry is not None
        assert views.at_estimate is not None
        assert content.tracks.odometry is not None
        assert np.allclose(content.tracks.odometry[index], TRUTH[index])
        assert views.at_odometry.mean_difference < 3.0
        assert views.at_estimate.mean_difference > views.at_odometry.mean_difference


def test_wall_from_above_ends_where_the_views_end() -> None:
    pose = world_from_base_planar(np.array([facing_wall(0.5, 2.0)])) @ MOUNT
    surface = surface_from_above(WALL, pose, [CAMERA])
    assert surface is not None
    assert surface.is_wall
    assert sorted(surface.outline[:, 0]) == pytest.approx([-1.5, 2.5])
    assert np.allclose(surface.outline[:, 1], 0.0)
    assert np.allclose(surface.away, [0.0, 1.0])


def test_trace_of_a_slanting_wall_lies_on_the_ground() -> None:
    """A wall that leans: at z = 0 it stands at y = 0.1, at the camera's height elsewhere."""
    normal = np.array([0.0, -1.0, 0.1]) / np.hypot(1.0, 0.1)
    plane = Plane(normal, 0.1 / np.hypot(1.0, 0.1))
    pose = world_from_base_planar(np.array([facing_wall(0.0, 2.0)])) @ MOUNT
    surface = surface_from_above(plane, pose, [CAMERA])
    assert surface is not None
    assert surface.is_wall
    assert np.allclose(surface.outline[:, 1], 0.1)


def test_floor_from_above_is_an_area() -> None:
    downward = base_from_camera_mount((0.0, 0.0, 1.0), (0.0, 90.0, 0.0))
    pose = world_from_base_planar(np.array([[1.0, 2.0, 0.0]])) @ downward
    surface = surface_from_above(Plane(np.array([0.0, 0.0, 1.0]), 0.0), pose, [CAMERA])
    assert surface is not None
    assert not surface.is_wall
    # From 1 m above: 48/24 m across, 36/24 m along.
    low, high = surface.outline.min(axis=0), surface.outline.max(axis=0)
    assert low == pytest.approx([1.0 - 0.75, 2.0 - 1.0])
    assert high == pytest.approx([1.0 + 0.75, 2.0 + 1.0])


def test_surface_behind_the_cameras_is_not_shown() -> None:
    away = np.array([[0.0, -2.0, -np.pi / 2.0]])
    assert surface_from_above(WALL, world_from_base_planar(away) @ MOUNT, [CAMERA]) is None


def test_a_path_that_runs_away_does_not_shrink_the_place() -> None:
    odometry = TRUTH + np.outer(np.arange(6.0), [1000.0, 0.0, 0.0])
    run = wall_run(odometry=odometry)
    extent = surroundings_of(wall_scene(), tracks_of(run, None)).extent
    assert extent[1] - extent[0] < 15.0


def test_ellipse_holds_95_percent() -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = turn @ np.diag([4.0, 0.25]) @ turn.T
    width, height, degrees = covariance_ellipse(covariance)
    assert degrees % 180.0 == pytest.approx(np.degrees(np.arctan2(0.6, 0.8)))
    points = np.random.default_rng(1).multivariate_normal([0, 0], covariance[:2, :2], 40_000)
    angle = np.radians(degrees)
    along = points @ [np.cos(angle), np.sin(angle)]
    across = points @ [-np.sin(angle), np.cos(angle)]
    inside = (2.0 * along / width) ** 2 + (2.0 * across / height) ** 2 <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.005)


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5, np.pi])
def test_arrow_points_along_the_heading(heading: float) -> None:
    marker = arrow_marker(heading)
    vertices = marker.get_transform().transform(marker.get_path().vertices)
    tip = vertices[np.argmax(np.linalg.norm(vertices, axis=1))]
    assert np.arctan2(tip[1], tip[0]) == pytest.approx(np.arctan2(np.sin(heading), np.cos(heading)))


def test_tones_fall_with_the_weight_and_end() -> None:
    log_weights = np.log([1.0, 0.1, 1e-4, 1e-9, 1e-300])
    assert particle_tones(log_weights - 500.0) == pytest.approx([1.0, 0.75, 0.0, 0.0, 0.0])
    with np.errstate(divide="ignore"):
        assert particle_tones(np.log([0.5, 0.0]))[1] == 0.0


def test_many_particles_are_thinned_and_the_best_stay() -> None:
    log_weights = np.random.default_rng(2).normal(size=3 * MAX_DOTS)
    shown = _shown(log_weights)
    assert MAX_DOTS // 2 < shown.sum() <= MAX_DOTS
    assert shown[np.argsort(log_weights)[-100:]].all()
    assert _shown(log_weights[:MAX_DOTS]).all()


@pytest.mark.parametrize("span", [0.07, 0.6, 1.0, 9.9, 13.0, 480.0])
def test_tick_steps_are_round_and_few(span: float) -> None:
    step = tick_step(span)
    assert 3.0 <= span / step < 7.5
    assert f"{step:.0e}"[0] in "125"


@pytest.mark.parametrize("aspect", [0.5, 1.0, 3.0])
def test_box_limits_keep_the_extent_inside_and_the_scale_equal(aspect: float) -> None:
    extent = np.array([-1.0, 3.0, 0.0, 2.0])
    x_min, x_max, y_min, y_max = box_limits(extent, aspect)
    assert (x_max - x_min) / (y_max - y_min) == pytest.approx(aspect)
    assert x_min <= -1.0
    assert x_max >= 3.0
    assert y_min <= 0.0
    assert y_max >= 2.0


def test_close_up_holds_estimate_truth_and_ellipse(content: Content) -> None:
    record, tracks = content.run.frames[3], content.tracks
    extent = close_up_extent(record, tracks, 3, content.surroundings)
    assert extent is not None
    # Two sigma and more of the mode: sqrt(5.99) * 0.1 m along x.
    for x, y in (TRUTH[3, :2], tracks.estimated[3, :2], record.modes[0, :2] + [0.244, 0.0]):
        assert extent[0] < x < extent[1]
        assert extent[2] < y < extent[3]
    wide = replace(record, covariance=np.diag([4.0, 4.0, 1.0]))
    assert close_up_extent(wide, tracks, 3, content.surroundings) is None


def drawn(figure: Figure) -> ImageArray:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=figure.dpi)
    with Image.open(buffer) as image:
        return np.asarray(image.convert("RGB"))


def text_boxes(figure: Figure) -> list[tuple[str, Bbox]]:
    """All texts that are drawn, with the pixels that they take."""
    hidden: set[int] = set()
    for axis in figure.findobj(Axis):
        assert isinstance(axis, Axis)
        low, high = sorted(axis.get_view_interval())
        margin = 1e-9 * (high - low)
        for tick in (*axis.majorTicks, *axis.minorTicks):
            # Ticks beyond the limits exist, but are not drawn.
            if not low - margin <= tick.get_loc() <= high + margin:
                hidden |= {id(tick.label1), id(tick.label2)}
    return [
        (text.get_text(), text.get_window_extent())
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and id(text) not in hidden
    ]


LONG = "a_very_long_folder_name/" * 8 + "{}.png"


def figures_of(content: Content) -> dict[str, Figure]:
    with figure_style():
        return {
            "overview": overview_figure(content),
            "frame": frame_figure(content, 3),
            "curves": time_figure(content.run, content.tracks, list(content.views)),
        }


@pytest.mark.parametrize(
    "run",
    [
        wall_run(image_name=LONG),
        wall_run(statuses="gtlltl", groundtruth=None, image_name=LONG),
        wall_run(offset=-12.34, image_name="\u202e\n\t{}"),
    ],
    ids=["tracking", "lost", "far off"],
)
def test_texts_stay_in_the_figure_and_apart(run: Run) -> None:
    for name, figure in figures_of(content_of(run)).items():
        drawn(figure)
        boxes = text_boxes(figure)
        assert len(boxes) > 20
        frame = figure.bbox
        for text, box in boxes:
            within = (
                box.x0 >= frame.x0 - 1
                and box.x1 <= frame.x1 + 1
                and box.y0 >= frame.y0 - 1
                and box.y1 <= frame.y1 + 1
            )
            assert within, (name, text)
        for (first, a), (second, b) in combinations(boxes, 2):
            assert not overlapping(a, b), (name, first, second)


def overlapping(a: Bbox, b: Bbox) -> bool:
    """More than a pixel in common, in both directions."""
    wide, high = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
    return bool(wide > 1 and high > 1)


@pytest.mark.parametrize("size", [(48, 36), (36, 54)], ids=["landscape", "portrait"])
def test_pictures_are_equal_in_size_and_aligned(size: tuple[int, int]) -> None:
    run = wall_run()
    if size != (48, 36):
        from pipelines.dataset.images import encode_png

        image = encode_png(np.zeros((size[1], size[0], 3), dtype=np.uint8))
        camera = Camera("SIMPLE_PINHOLE", *size, (24.0, 17.5, 26.5))
        run = replace(run, camera=camera, encoded_images=(image,) * 6)
    content = content_of(run)
    with figure_style():
        figures = [overview_figure(content), frame_figure(content, 3)]
    for figure in figures:
        drawn(figure)
        pictures = [axes.get_window_extent() for axes in figure.axes if axes.images]
        rows: dict[int, list[Bbox]] = {}
        for box in pictures:
            rows.setdefault(round(box.y0), []).append(box)
            assert box.width / box.height == pytest.approx(size[0] / size[1], rel=1e-3)
        assert len({(round(box.width, 2), round(box.height, 2)) for box in pictures}) == 1
        assert 3 in {len(row) for row in rows.values()}


def test_top_views_have_equal_scales(content: Content) -> None:
    with figure_style():
        figures = [overview_figure(content), frame_figure(content, 3)]
    for figure in figures:
        drawn(figure)
        views = [axes for axes in figure.axes if axes.get_xlabel() == "x in m"]
        assert views
        for axes in views:
            box = axes.get_window_extent()
            (x_min, x_max), (y_min, y_max) = axes.get_xlim(), axes.get_ylim()
            scale = box.width / (x_max - x_min)
            assert scale == pytest.approx(box.height / (y_max - y_min), rel=1e-6)
            assert axes.get_ylabel() == "y in m"


def test_names_are_shortened_to_their_end() -> None:
    assert shortened("rgb/0001.png") == "rgb/0001.png"
    assert shortened("folder/" * 20 + "7.png").endswith("/7.png")
    assert len(shortened("x" * 500)) == 30
    assert "\n" not in shortened("a\nb\u202ec")


def test_curves_show_the_errors_that_were_made(content: Content) -> None:
    with figure_style():
        figure = time_figure(content.run, content.tracks, [0])
    position = figure.axes[0]
    (line,) = [line for line in position.lines if line.get_label() == "estimate"]
    assert np.asarray(line.get_ydata()) == pytest.approx(np.full(6, 5.0))
    assert position.get_ylabel() == "position error\nin cm"


def test_unknown_errors_are_not_called_errors() -> None:
    run = wall_run(groundtruth=None)
    with figure_style():
        figure = time_figure(run, tracks_of(run, None), [0])
    assert "error unknown" in figure.axes[0].get_ylabel()
    assert "estimate" not in [line.get_label() for line in figure.axes[0].lines]


def test_stages_keep_their_order_and_unknown_ones_follow() -> None:
    run = wall_run()

    def with_stage(frame: FrameRecord) -> FrameRecord:
        return replace(frame, seconds={"zeal": 0.5, **frame.seconds})

    frames = tuple(with_stage(f) if i else f for i, f in enumerate(run.frames))
    stages = stage_seconds(replace(run, frames=frames))
    assert list(stages) == ["motion", "likelihood", "zeal"]
    assert stages["zeal"].tolist() == [0.0, 0.5, 0.5, 0.5, 0.5, 0.5]


def test_a_towering_bar_is_cut_and_says_its_height() -> None:
    run = wall_run()
    frames = tuple(
        replace(f, seconds={"likelihood": 30.0 if i == 0 else 0.1 + 0.01 * i})
        for i, f in enumerate(run.frames)
    )
    run = replace(run, frames=frames)
    with figure_style():
        axes = time_figure(run, tracks_of(run, None), [0]).axes[4]
    assert axes.get_ylabel() == "time a frame\nin ms"
    assert axes.get_ylim()[1] == pytest.approx(1.6 * 150.0)
    assert [text.get_text() for text in axes.texts] == ["30,000 ms, cut off here"]
