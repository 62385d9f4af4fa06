"""What differences of pixels say, learnt from photos that are left out one by one."""

import math

import numpy as np
import pytest

from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.geometry.pose import world_from_base_planar
from pipelines.lightfield.views import Views, build_views
from pipelines.render.channels import channel_image, views_in_channels
from pipelines.render.choices import Channels, Cost
from pipelines.render.comparison import EVIDENCE_BIN, EVIDENCE_BINS, EVIDENCE_ROWS, PixelEvidence
from pipelines.render.pixel_evidence import UNKNOWN_SHARE, learn_evidence
from pipelines.render.renderer import Renderer
from tests.lightfield_samples import WALL, looking, pinhole
from tests.report_samples import CAMERA, MOUNT, facing_wall, photo_from

WIDTH = 24


def wall_views(count: int, camera_size: tuple[int, int] = (48, 36)) -> Views:
    """Photos of the painted wall, half a metre apart."""
    xs = 0.5 * (np.arange(count) - (count - 1) / 2.0)
    poses = world_from_base_planar(np.array([facing_wall(x, 2.0) for x in xs])) @ MOUNT
    camera = CAMERA.intrinsics.resized(*camera_size)
    return build_views([photo_from(pose, camera) for pose in poses], [camera] * count, poses)


def learnt(
    views: Views, channels: Channels = Channels.CONTRAST, width: int = WIDTH
) -> PixelEvidence:
    renderer = Renderer(views_in_channels(views, channels), WALL, threads=1)
    return learn_evidence(views, channels, width, renderer)


@pytest.fixture(scope="module")
def evidence() -> PixelEvidence:
    return learnt(wall_views(7))


def assert_usable(evidence: PixelEvidence) -> None:
    assert evidence.edges.shape == (EVIDENCE_ROWS - 1,)
    assert evidence.table.shape == (EVIDENCE_ROWS, EVIDENCE_BINS)
    assert evidence.edges.dtype == evidence.table.dtype == np.float32
    assert np.isfinite(evidence.edges).all()
    assert np.isfinite(evidence.table).all()
    assert np.all(np.diff(evidence.edges) >= 0.0)
    # However far a pixel is off, it may show what no map can know.
    assert evidence.table.min() >= math.log(UNKNOWN_SHARE) - 1e-5


def test_what_fits_speaks_for_the_map_and_what_does_not_against_it(
    evidence: PixelEvidence,
) -> None:
    assert_usable(evidence)
    strong = evidence.table[EVIDENCE_ROWS // 2 :]
    assert np.all(strong[:, :2] > 0.3)
    assert np.all(strong[-2:, 18:].max(axis=1) < 0.0)
    # The smaller the difference the better.
    assert np.all(strong[:, 0] > strong[:, 6])
    assert np.all(strong[:, 6] > strong[:, 16])


def test_pixels_that_show_next_to_nothing_earn_next_to_nothing() -> None:
    # Half of the wall is bare.
    xs = np.arange(-1.5, 1.6, 0.5)
    poses = world_from_base_planar(np.array([facing_wall(x, 2.0) for x in xs])) @ MOUNT
    images = []
    for pose in poses:
        image = photo_from(pose)
        image[:, : CAMERA.width // 2] = 150
        images.append(image)
    found = learnt(build_views(images, [CAMERA.intrinsics] * len(xs), poses))
    assert_usable(found)
    faintest = int(found.rows(np.full(3, 128.0, dtype=np.float32)))
    assert found.table[faintest].max() < 0.05
    assert found.table[EVIDENCE_ROWS - 1].max() > 0.5


def histogram_by_hand(views: Views, width: int) -> tuple[FloatArray, FloatArray]:
    """Mean differences of left-out photos at their own poses, and at their neighbours'."""
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    for index, camera in enumerate(views.intrinsics):
        poses[index, :3, :3] = views.arrays.rays[index] @ camera.matrix()
    poses[:, :3, 3] = views.centres
    images = [views.level(index, 0) for index in range(len(views))]
    own: list[FloatArray] = []
    other: list[FloatArray] = []
    for index in range(len(views)):
        rest = [i for i in range(len(views)) if i != index]
        others = build_views(
            [images[i] for i in rest], [views.intrinsics[i] for i in rest], poses[rest]
        )
        renderer = Renderer(views_in_channels(others, Channels.CONTRAST), WALL, threads=1)
        camera = views.intrinsics[index].resized(width, round(width * 36 / 48))
        factor = views.intrinsics[index].width // width
        small = images[index].reshape(camera.height, factor, width, factor, 3).mean(axis=(1, 3))
        target = channel_image(small.astype(np.float32), Channels.CONTRAST)
        for collected, pose in ((own, poses[index]), (other, poses[rest[index // 2]])):
            image, covered = renderer.render_many(pose[None], camera)
            collected.append(np.abs(image[0] - target).sum(axis=2)[covered[0]])
    return np.concatenate(own), np.concatenate(other)


def test_the_table_tells_right_poses_from_wrong_ones_as_the_differences_themselves_do(
    evidence: PixelEvidence,
) -> None:
    own, other = histogram_by_hand(wall_views(7), WIDTH)
    bins = np.minimum(np.arange(EVIDENCE_BINS + 1) * EVIDENCE_BIN, 1e9)
    bins[-1] = np.inf
    right = np.histogram(own, bins)[0] / len(own)
    wrong = np.histogram(other, bins)[0] / len(other)
    # Where right poses are many times as frequent, evidence is positive, and the reverse.
    middle = evidence.table[EVIDENCE_ROWS // 2 :].mean(axis=0)
    assert np.all(middle[(right > 3.0 * wrong) & (wrong > 0.005)] > 0.0)
    assert np.all(middle[(3.0 * right < wrong) & (wrong > 0.02)] < 0.0)
    assert np.any(right > 3.0 * wrong)
    assert np.any(3.0 * right < wrong)


def test_an_image_of_the_map_has_evidence_for_its_pose_and_others_against() -> None:
    views = wall_views(7)
    evidence = learnt(views)
    renderer = Renderer(views_in_channels(views, Channels.CONTRAST), WALL, threads=1)
    camera = CAMERA.intrinsics.resized(WIDTH, 18)
    truth = world_from_base_planar(facing_wall(-0.3, 1.9, 0.1)) @ MOUNT
    wrong = world_from_base_planar(facing_wall(0.9, 1.4, -0.2)) @ MOUNT
    image = channel_image(photo_from(truth, camera).astype(np.float32), Channels.CONTRAST)
    noise = np.random.default_rng(0).integers(0, 256, image.shape).astype(np.float32)
    other = channel_image(noise, Channels.CONTRAST)
    poses = np.stack([truth, wrong])
    costs = renderer.costs(poses, camera, image, Cost.EVIDENCE, False, evidence)
    pixels = image[..., 0].size
    assert -costs[0] / pixels > 0.5
    assert -costs[1] / pixels < 0.05
    strange = renderer.costs(poses, camera, other, Cost.EVIDENCE, False, evidence)
    assert np.all(-strange / pixels < 0.0)


@pytest.mark.parametrize("channels", Channels)
def test_the_same_photos_teach_the_same(channels: Channels) -> None:
    views = wall_views(4)
    before = views.arrays.texels.copy()
    first, again = learnt(views, channels), learnt(views, channels)
    np.testing.assert_array_equal(first.table, again.table)
    np.testing.assert_array_equal(first.edges, again.edges)
    np.testing.assert_array_equal(views.arrays.texels, before)
    assert_usable(first)


# --- maps of few photos, and of nothing --------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 3])
def test_maps_of_few_photos_have_evidence_too(count: int) -> None:
    evidence = learnt(wall_views(count))
    assert_usable(evidence)
    strong = evidence.table[EVIDENCE_ROWS // 2 :]
    assert np.all(strong[:, 0] > 0.0)
    assert np.all(strong[:, -1] < 0.0)


def around_a_point(images: list[ImageArray]) -> Views:
    poses = [looking([0.3 * i, -2.0, 1.0], [0.0, 0.0, 1.0]) for i in range(len(images))]
    cameras = [pinhole(image.shape[1], image.shape[0], float(image.shape[1])) for image in images]
    return build_views(images, cameras, np.array(poses))


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (3, 5), (36, 48)])
@pytest.mark.parametrize("width", [1, 4, 24])
def test_photos_of_any_size_and_without_content_do_no_harm(
    shape: tuple[int, int], width: int
) -> None:
    generator = np.random.default_rng(0)
    for images in (
        [np.full((*shape, 3), 90, dtype=np.uint8)] * 3,
        [generator.integers(0, 256, (*shape, 3)).astype(np.uint8) for _ in range(3)],
    ):
        views = around_a_point(images)
        for channels in Channels:
            assert_usable(learnt(views, channels, width))


def test_an_empty_map_has_no_evidence_for_anything() -> None:
    """Bare walls fit each other everywhere: that says nothing."""
    views = around_a_point([np.full((36, 48, 3), 90, dtype=np.uint8)] * 4)
    evidence = learnt(views)
    row = int(evidence.rows(np.full(3, 128.0, dtype=np.float32)))
    assert abs(evidence.table[row, 0]) < 0.05


def test_photos_that_do_not_see_each_other_teach_what_does_not_fit() -> None:
    images = [
        np.random.default_rng(seed).integers(0, 256, (36, 48, 3)).astype(np.uint8)
        for seed in (0, 1)
    ]
    poses = np.array(
        [looking([x, -2.0, 1.0], [x, 0.0, 1.0]) for x in (0.0, 50.0)],
    )
    evidence = learnt(build_views(images, [pinhole(48, 36, 40.0)] * 2, poses))
    assert_usable(evidence)
    assert np.all(evidence.table[:, 0] > 0.0)
    assert np.all(evidence.table[:, 16:].max(axis=1) < 0.0)
