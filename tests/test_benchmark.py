"""The benchmark compares like with like: all ways compute the same images and costs."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks import against, cold_start, run, scoring, tracking
from benchmarks import gpu as gpu_benchmark
from benchmarks.comparison import (
    LIMIT,
    OPENCV,
    fused,
    fused_costs,
    nanoseconds_per_sample,
    ratios,
    table,
    times_limit,
)
from benchmarks.limit import limit_image, limit_work
from benchmarks.opencv_path import opencv_costs, opencv_image, opencv_work
from benchmarks.processes import process_times
from benchmarks.scenes import ROOT, repeated, with_wall_as_depth, workshop_scene
from benchmarks.timing import Timing, machine, median_times, timing_table
from benchmarks.torch_path import is_installed, torch_costs, torch_work
from benchmarks.work import Work, every_other, net_weights, work_of
from pipelines.dataset.dataset import load_dataset
from pipelines.geometry.plane import plane_from_coefficients
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene, save_scene
from pipelines.render.choices import Blending
from pipelines.render.renderer import Renderer

if TYPE_CHECKING:
    from pipelines.render.gpu_device import Gpu


@pytest.fixture(scope="module")
def scene() -> Scene:
    return workshop_scene()


@pytest.fixture(scope="module")
def work(scene: Scene) -> Work:
    return work_of(scene, 40, 30, count=6)


def renderer_of(work: Work, blending: Blending) -> Renderer:
    return Renderer(work.views, work.scene.plane, blending, threads=1)


@pytest.mark.parametrize("channels", OPENCV)
def test_opencv_computes_the_images_of_the_net(work: Work, channels: int) -> None:
    prepared, renderer = opencv_work(work, channels), renderer_of(work, Blending.DELAUNAY)
    warped, image = np.empty_like(prepared.query), np.empty_like(prepared.query)
    for particle, pose in enumerate(work.poses):
        rendering = renderer.render(pose, work.intrinsics)
        assert rendering.coverage == 1.0
        opencv_image(prepared, particle, warped, image)
        difference = np.abs(image[..., :3] - rendering.image)
        # Positions are rounded to 1/32 pixel there, grey levels to whole numbers here.
        assert difference.max() < 3.0
        assert difference.mean() < 1.0


@pytest.mark.parametrize("channels", OPENCV)
def test_opencv_computes_the_costs(work: Work, channels: int) -> None:
    costs = fused_costs(renderer_of(work, Blending.DELAUNAY), work)
    np.testing.assert_allclose(opencv_costs(opencv_work(work, channels)), costs, atol=2e-4)
    assert costs.max() > 0.005
    assert costs[0] < 1e-4


@pytest.mark.skipif(not is_installed(), reason="PyTorch is not installed")
def test_torch_computes_the_costs(work: Work) -> None:
    costs = fused_costs(renderer_of(work, Blending.DELAUNAY), work)
    np.testing.assert_allclose(torch_costs(torch_work(work)), costs, atol=1e-6, rtol=1e-4)


def test_the_limit_computes_the_same_image(work: Work) -> None:
    """Nothing that counts is left out: only what was given beforehand."""
    rendering = renderer_of(work, Blending.DELAUNAY).render_with_surface(
        work.poses[0], work.intrinsics
    )
    for times in (1, 3):
        image = limit_image(limit_work(work), times).reshape(30, 40, 4)
        np.testing.assert_allclose(image[..., :3], rendering.image, atol=0.02)
        np.testing.assert_allclose(image[..., 3], 255.0, atol=0.01)


def test_a_fifth_and_a_quarter_of_the_pixels_say_the_same(work: Work) -> None:
    """What is compared with each other is about the same work."""
    renderer = renderer_of(work, Blending.DELAUNAY)
    whole, fifth = fused_costs(renderer, work), fused_costs(renderer, work, 5)
    quarter = opencv_costs(opencv_work(every_other(work), 4))
    assert np.all(np.abs(fifth[1:] / whole[1:] - 1.0) < 0.15)
    assert np.all(np.abs(quarter[1:] / whole[1:] - 1.0) < 0.15)


def test_three_views_are_blended_at_every_pixel(work: Work) -> None:
    for pose in work.poses:
        weights = net_weights(work, pose)
        assert weights.min() > 0.0
        np.testing.assert_allclose(weights.sum(axis=0), 1.0, atol=1e-5)
    # As large as the virtual pixels: neither finer nor coarser photos are read.
    assert np.all(work.views.arrays.level_size[:, 0] == [80, 60])


def test_the_table_shows_times_ratios_and_limits() -> None:
    delaunay, unstructured = (fused(blending, one_in=1) for blending in Blending)
    row = {delaunay: 100.0, unstructured: 400.0, OPENCV[3]: 300.0, OPENCV[4]: 200.0, LIMIT: 50.0}
    figures = {"40x30": row, "80x60": {name: 4.0 * value for name, value in row.items()}}
    assert ratios(figures, Blending.DELAUNAY, 1) == {"40x30": 2.0, "80x60": 2.0}
    assert ratios(figures, Blending.UNSTRUCTURED, 1) == {"40x30": 0.5, "80x60": 0.5}
    assert times_limit(figures, Blending.DELAUNAY) == {"40x30": 2.0, "80x60": 2.0}
    assert times_limit(figures, Blending.UNSTRUCTURED) == {"40x30": 8.0, "80x60": 8.0}
    # 50 microseconds for three samples at each of 1200 pixels.
    assert nanoseconds_per_sample(figures) == {"40x30": 13.889, "80x60": 13.889}
    figures["40x30"] = {**row, "once": 5000.0}
    lines = table(figures).splitlines()
    assert lines[1] == "|---|---:|---:|"
    assert lines[2] == f"| {delaunay} | 100.0 (2.00; 2.0) | 400.0 (2.00; 2.0) |"
    assert lines[-1] == "| once | 5000.0 (0.04; 100.0) |  |"


def test_frames_are_told_apart_by_what_the_filter_calls_them() -> None:
    def frame(status: str) -> tracking.Frame:
        return tracking.Frame(status, Timing(0.1, 0.1), {})

    drives = [[frame(status) for status in ("tracking", "global", "tracking", "lost")]]
    # The first frame is a search, whatever comes of it.
    assert tracking.tracked_frames(drives) == [drives[0][2]]


def test_particles_stand_around_the_true_place() -> None:
    states = scoring.states_around(2000)
    test_drive = load_dataset(ROOT / "sample_data" / "elevators" / "test")
    assert test_drive.groundtruth is not None
    truth = test_drive.groundtruth.poses[scoring.FRAME][:2, 3]
    np.testing.assert_allclose(states[:, :2].mean(axis=0), truth, atol=0.02)
    np.testing.assert_allclose(states.std(axis=0), scoring.SPREAD, rtol=0.1)


def test_the_tables_of_particles_show_what_was_measured() -> None:
    cell = {"cpu": 20.0, "wall": 10.0}
    results = {
        "views_growth": {"28": 1.0},
        "views_growth_all_pixels": {"28": 1.5},
        "particles_growth": {"195": 1.0},
        "scoring": {
            "by_size": {"plane": {"40x30": cell}},
            "by_views": {"28": cell},
            "by_views_all_pixels": {"28": cell},
            "by_particles": {"195": cell},
        },
    }
    lines = scoring.tables(results).splitlines()
    assert "| plane | 20.0 (10.0) |" in lines
    assert "| 28 | 20.0 (10.0) | 1.00 |" in lines
    assert "| 28 | 20.0 (10.0) | 1.50 |" in lines
    assert "| 195 | 20.0 (10.0) | 1.00 |" in lines


def test_the_drive_of_one_image_ends_with_it(tmp_path: Path) -> None:
    cold_start.drive_of_one_image(tmp_path / "drive")
    assert len(load_dataset(tmp_path / "drive")) == 1


def test_the_first_answer_is_that_of_the_drive_of_one_image(tmp_path: Path) -> None:
    localize = cold_start.commands(tmp_path)[cold_start.LOCALIZE]
    assert str(tmp_path / cold_start.ONE_IMAGE) in localize
    assert localize[-3:] == ["-o", str(tmp_path / cold_start.RUN), "--overwrite"]
    times = {cold_start.HELP: Timing(0.04, 0.05).to_dict()}
    lines = cold_start.table({"cold_start": {"times": times}}).splitlines()
    assert lines[-1] == "| lfnav --help | 40 | 50 |"


def test_processes_are_timed_with_their_waiting(tmp_path: Path) -> None:
    said = tmp_path / "said"
    code = f"import time; open({str(said)!r}, 'a').write('x'); time.sleep(0.5)"
    times = process_times([sys.executable, "-c", code], turns=2, rehearsals=1)
    assert said.read_text(encoding="utf-8") == "xxx"
    assert len(times) == 2
    assert all(0.0 < each.cpu < 0.5 <= each.wall for each in times)


def test_results_hold_what_they_promise() -> None:
    """The file in the repository is what this code writes."""
    results = json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))
    compared = [f"ratio_to_opencv{rest}" for rest in ("", "_unstructured", "_all_pixels")]
    for key in (*compared, "ratio_to_opencv_of_a_quarter", "times_limit", "depth_to_plane"):
        assert set(results[key]) == {"40x30", "80x60", "160x120"}
        assert all(value > 0.0 for value in results[key].values())
    assert set(results["frames_per_second"]) == {"tracking", "tracking_refined"}
    assert results["global_start_s"] > 0.0
    assert set(results["machine"]) >= {"cpu", "processors", "python", "numpy"}
    assert run.tables(results).count("|---|") >= 10


def test_the_machine_is_named() -> None:
    assert set(machine()) >= {"cpu", "processors", "python", "lfnav", "numpy"}


def test_tasks_take_turns_and_the_first_does_not_count() -> None:
    calls: list[str] = []
    times = median_times({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert calls == ["a", "b"] * 4
    assert set(times) == {"a", "b"}
    calls.clear()
    median_times({"a": lambda: calls.append("a")}, 2, rehearsals=0)
    assert calls == ["a", "a"]
    assert Timing(6.0, 3.0).of_each(3) == Timing(2.0, 1.0)
    rows = timing_table("what", {"x": Timing(0.5, 0.25).to_dict()}).splitlines()
    assert rows == ["| what | CPU (ms) | wall (ms) |", "|---|---:|---:|", "| x | 500 | 250 |"]


def test_repeated_photos_are_a_scene_that_opens(scene: Scene, tmp_path: Path) -> None:
    many = repeated(scene, 100)
    save_scene(tmp_path / "many.h5", many, overwrite=False)
    opened = load_scene(tmp_path / "many.h5")
    assert len(opened) == len(np.unique(opened.world_from_camera, axis=0)) == 100
    assert (opened.cameras[0].width, opened.cameras[0].height) == (640, 480)


def test_depth_of_the_wall_is_where_the_wall_is(scene: Scene) -> None:
    """The camera's axis meets y = 0 at as many metres as the depth map says."""
    deep = with_wall_as_depth(scene)
    wall = plane_from_coefficients((0.0, -1.0, 0.0, 0.0))
    for index in (0, 17, 39):
        pose, depth = deep.world_from_camera[index], deep.depth[index].inverse_depth
        assert depth.shape == (360, 480)
        metres = 1.0 / float(depth[179:181, 239:241].mean())
        assert abs(wall.signed_distance(pose[:3, 3] + metres * pose[:3, 2])) < 0.01


def test_peak_memory_is_the_largest_not_the_last() -> None:
    code = (
        "from benchmarks.memory import own_peak\n"
        "import numpy as np\n"
        "before = own_peak()\n"
        "np.ones(25_000_000)\n"
        "print(own_peak() - before)"
    )
    command = [sys.executable, "-c", code]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert 190e6 < int(output.stdout) < 230e6


def test_a_software_adapter_is_measured_for_agreement_alone(
    scene: Scene, gpu: "Gpu", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gpu_benchmark, "AGREEMENT_PARTICLES", 20)
    monkeypatch.setattr(gpu_benchmark, "chosen_gpu", lambda _: replace(gpu, is_software=True))
    figures = gpu_benchmark.measure(scene)["gpu"]
    assert len(figures["differences"]) == 4
    for of in figures["differences"].values():
        assert 0.0 < of["median"] <= of["largest"] < 2e-4
    assert "particles_per_second" not in figures
    assert "software adapter" in gpu_benchmark.table(figures)


def test_figures_of_a_gpu(scene: Scene, gpu: "Gpu", monkeypatch: pytest.MonkeyPatch) -> None:
    """Their arithmetic; a software adapter stands in for a GPU."""
    monkeypatch.setattr(gpu_benchmark, "seconds", lambda work: (work(), 0.5)[1])
    work = gpu_benchmark.work_of(scene, 8)
    on_gpu = gpu_benchmark.gpu_renderer(work, gpu)
    figures = gpu_benchmark.speed(
        gpu_benchmark.cpu_renderer(work), on_gpu, work, (2, 8, 4), groups=1
    )
    assert figures["frame_ms"] == 500.0
    assert figures["particles_per_second"] == 16.0
    assert figures["times_cpu"] == pytest.approx(2.0)
    assert figures["texels_per_second"] == 2 * 4 * 256 * 64
    needed = 16.0 * gpu_benchmark.reads_per_particle(on_gpu, work)
    assert figures["share_of_texture_rate"] == pytest.approx(needed / (2 * 4 * 256 * 64))
    # Between one and all twelve views a pixel.
    assert 4.0 < gpu_benchmark.reads_per_particle(on_gpu, work) / (40 * 30) < 4 * 12
    shown = {"device": "GPU", "is_software": False, "size": "40x30", "differences": {}}
    assert "| 500.00 ms |" in gpu_benchmark.table({**shown, **figures})


def test_without_a_gpu_the_table_says_why(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "wgpu", None)
    assert "pip install" in gpu_benchmark.table(gpu_benchmark.measure(scene)["gpu"])


class RecordedSide(against.Side):
    """Takes so many seconds for everything, and writes down when it was asked."""

    def __init__(self, name: str, seconds: float, asked: list[str]) -> None:
        self.works = ["a view"]
        self._name, self._seconds, self._asked = name, seconds, asked

    def time(self, work: str, seconds: float) -> Timing:
        self._asked.append(self._name)
        # The first time everything is loaded.
        return Timing(self._seconds if seconds else 1e3, self._seconds)


def test_two_revisions_take_turns_and_loading_does_not_count() -> None:
    asked: list[str] = []
    sides = [RecordedSide("before", 0.5, asked), RecordedSide("now", 0.2, asked)]
    assert against.compared(sides, "a view", turns=3) == [Timing(0.5, 0.5), Timing(0.2, 0.2)]
    assert asked == ["before", "now"] * 4
