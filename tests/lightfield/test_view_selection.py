"""The choice of views against brute force, geometry, and photos that were left out."""

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from lfnav_cli import common
from lfnav_cli.main import main
from pipelines.artifacts.arrays import Float32Array, FloatArray, IntArray
from pipelines.artifacts.errors import OptionError
from pipelines.artifacts.stages import no_progress
from pipelines.geometry.plane import Plane
from pipelines.lightfield.scene import Scene, SceneDepth
from pipelines.lightfield.scene_file import load_scene, scene_provenance
from pipelines.lightfield.stage import ModelSettings
from pipelines.lightfield.view_selection import KnownSurface, greedy_cover, select_views
from pipelines.lightfield.views import build_views, views_of_scene
from pipelines.reconstruct.reconstruction import with_images
from pipelines.render.image_quality import psnr
from pipelines.render.renderer import Renderer
from tests.lightfield_samples import WALL, looking, pinhole, pinhole_rays, pixels_of
from tests.reconstruct_samples import small_reconstruction

SAMPLES = Path(__file__).parents[2] / "sample_data" / "elevators"
CAMERA = pinhole(64, 48, 60.0)
NO_POINTS, NO_OBSERVATIONS = np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64)
ON_WALL = KnownSurface(WALL, NO_POINTS, NO_OBSERVATIONS)


def value(benefit: Float32Array, rows: tuple[int, ...] | IntArray) -> float:
    return float(benefit[np.asarray(rows)].max(axis=0).sum(dtype=np.float64))


def random_benefit(seed: int) -> Float32Array:
    """Sparse, as views see only a part; with ties."""
    generator = np.random.default_rng(seed)
    benefit = generator.integers(0, 6, (9, 14)) * (generator.uniform(size=(9, 14)) < 0.4)
    return benefit.astype(np.float32)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("count", [1, 2, 4])
def test_greedy_is_near_the_best_of_all_choices(seed: int, count: int) -> None:
    benefit = random_benefit(seed)
    best = max(value(benefit, rows) for rows in combinations(range(9), count))
    chosen = greedy_cover(benefit, count)
    assert len(set(chosen.tolist())) == len(chosen) <= count
    assert value(benefit, chosen) >= (1.0 - 1.0 / np.e) * best
    if count == 1:
        assert value(benefit, chosen) == best


@pytest.mark.parametrize("seed", range(12))
def test_lazy_greedy_is_greedy(seed: int) -> None:
    benefit = random_benefit(seed)
    plain: list[int] = []
    while len(plain) < 6:
        gains = [value(benefit, [*plain, row]) for row in range(9)]  # type: ignore[arg-type]
        if plain and max(gains) == value(benefit, tuple(plain)):
            break
        plain.append(int(np.argmax(gains)))
    assert greedy_cover(benefit, 6).tolist() == plain


def selected(poses: FloatArray, count: int, surface: KnownSurface = ON_WALL) -> list[int]:
    cameras = [CAMERA] * len(poses)
    return [int(i) for i in select_views(poses, cameras, surface, count, no_progress)]


def along(xs: list[float]) -> FloatArray:
    return np.array([looking([x, -2.0, 1.0], [x, 0.0, 1.0]) for x in xs])


def test_one_of_each_cluster_is_kept() -> None:
    xs = [-3.0, 0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 3.0, 3.02, 6.0]
    kept = selected(along(xs), 4)
    assert [round(xs[index]) for index in kept] == [-3, 0, 3, 6]
    # Within a cluster that in its middle, from which the rays of the others differ least.
    assert xs[kept[1]] == 0.03


def test_a_copy_adds_nothing() -> None:
    assert selected(along([0.0, 1.0, 1.0, 0.0, 2.0]), 4) == [0, 1, 4]


def test_all_are_kept_where_there_is_room() -> None:
    poses = along([0.0, 1.0, 1.0])
    assert selected(poses, 3) == selected(poses, 99) == [0, 1, 2]
    with pytest.raises(OptionError, match="at least 1"):
        selected(poses, 0)
    with pytest.raises(OptionError, match="less than 1"):
        ModelSettings(max_views=0)


def known_surface(kind: str, poses: FloatArray) -> KnownSurface:
    """The wall as depth maps or sparse points, beside a plane that is far behind it."""
    behind = Plane(np.array([0.0, -1.0, 0.0]), 40.0)
    if kind == "plane":
        return KnownSurface(behind, NO_POINTS, NO_OBSERVATIONS)
    depth = SceneDepth(np.full((48, 64), 0.5, np.float32), np.ones((48, 64), dtype=np.bool_))
    if kind == "depth":
        return KnownSurface(behind, NO_POINTS, NO_OBSERVATIONS, [depth] * len(poses))
    rays = pinhole_rays(CAMERA, pixels_of(CAMERA)[::6, ::6]).reshape(-1, 3)
    points = np.concatenate([pose[:3, 3] + 2.0 * rays @ pose[:3, :3].T for pose in poses])
    views = np.repeat(np.arange(len(poses)), len(rays))
    return KnownSurface(behind, points, np.column_stack([np.arange(len(points)), views]))


def test_depth_and_points_are_better_known_than_the_plane() -> None:
    """From far away neighbouring cameras look alike, at two metres they do not."""
    generator = np.random.default_rng(4)
    poses = along(np.sort(generator.uniform(-4.0, 4.0, 24)).tolist())
    expected = selected(poses, 8)
    assert selected(poses, 8, known_surface("depth", poses)) == expected
    assert selected(poses, 8, known_surface("points", poses)) == expected
    assert selected(poses, 8, known_surface("plane", poses)) != expected


def test_part_of_a_reconstruction(tmp_path: Path) -> None:
    whole = small_reconstruction(tmp_path)
    part = with_images(whole, np.array([1, 3]))
    assert part.image_names == (whole.image_names[1], whole.image_names[3])
    for place, image in enumerate((1, 3)):
        np.testing.assert_array_equal(part.world_from_camera[place], whole.world_from_camera[image])
        own, others = part.observations[:, 1] == place, whole.observations[:, 1] == image
        assert own.sum() == others.sum() > 0
        np.testing.assert_array_equal(part.observations[own, 0], whole.observations[others, 0])
        np.testing.assert_array_equal(part.observed_pixels[own], whole.observed_pixels[others])


# --- on photos ---------------------------------------------------------------------------------


def lfnav(*arguments: str | Path) -> None:
    assert common.run_command(main, [str(argument) for argument in arguments]) == 0


@pytest.fixture(scope="module")
def reconstruction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("elevators") / "reconstruction"
    poses = ("--method", "poses", "--poses", SAMPLES / "map" / "groundtruth.txt")
    lfnav("reconstruct", SAMPLES / "map", "-o", target, *poses, "--quiet")
    return target


def modelled(reconstruction: Path, target: Path, *options: str) -> Scene:
    lfnav("model", reconstruction, "-o", target, "--plane", "0,1,0,0", "--quiet", *options)
    return load_scene(target)


def test_chosen_views_show_the_others_better_than_any_other_choice(
    reconstruction: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half of the photos: every second one, five random halves, and those that are chosen."""
    whole = modelled(reconstruction, tmp_path / "all.h5")
    part = modelled(reconstruction, tmp_path / "part.h5", "--max-views", "14")
    kept = np.array([whole.image_names.index(name) for name in part.image_names])
    assert len(kept) == 14
    left_out = sorted(set(whole.image_names) - set(part.image_names))
    assert scene_provenance(tmp_path / "part.h5")["left_out"] == left_out
    lfnav("info", tmp_path / "part.h5", "--json")
    assert json.loads(capsys.readouterr().out)["left_out"] == left_out
    lfnav("info", tmp_path / "part.h5")
    assert "chosen from 28; 14 left out" in capsys.readouterr().out
    views = views_of_scene(whole, 120)
    images = [np.ascontiguousarray(views.level(index, 0)) for index in range(28)]

    def quality(rows: IntArray) -> float:
        """PSNR in dB of the photos that are left out, rendered from the others."""
        fewer = build_views(
            [images[row] for row in rows],
            [views.intrinsics[row] for row in rows],
            whole.world_from_camera[rows],
        )
        renderer = Renderer(fewer, whole.plane, threads=1)
        shown = []
        for index in sorted(set(range(28)) - set(rows.tolist())):
            pose = whole.world_from_camera[index]
            rendering = renderer.render(pose, views.intrinsics[index])
            shown.append(psnr(rendering.image, images[index], rendering.covered))
        return float(np.mean(shown))

    generator = np.random.default_rng(0)
    others = [np.arange(0, 28, 2), np.arange(1, 28, 2)]
    others += [np.sort(generator.choice(28, 14, replace=False)) for _ in range(5)]
    assert quality(kept) > max(quality(rows) for rows in others) + 0.3
