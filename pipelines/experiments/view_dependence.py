"""The benefit of view-dependent appearance: a light field against a view-independent texture.

On specular surfaces the colour of a point depends on the viewpoint. A texture has one colour a
point; a light field shows each point as photos from near the virtual camera saw it. Both are
compared over the same geometry on flat parts of a scene, with held-out photos. The geometry is the
depth computed from the photos, the true depth of the parts, or the scene's plane. A mirror image
has a depth of its own, behind the surface, so that the true depth need not be the best.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray, ImageArray
from pipelines.artifacts.errors import StageError
from pipelines.artifacts.stages import Progress
from pipelines.experiments.flat_parts import FlatPart, parts_inverse_depth
from pipelines.experiments.texture import texture_colours
from pipelines.geometry.plane import Plane
from pipelines.lightfield.views import Views, with_depth, without_depth
from pipelines.render.choices import Blending, Quality
from pipelines.render.held_out import HeldOut
from pipelines.render.image_quality import psnr
from pipelines.render.renderer import Renderer

GEOMETRIES = {
    "own": "depth from the photos",
    "true": "true depth of the parts",
    "plane": "one plane",
}
RULES = {"light_field": "light field", "mean": "mean texture", "median": "median texture"}
# One in this many rows and columns of a photo is compared: neighbouring pixels are similar.
STEP = 2
# A photo counts when the parts fill at least this share of it.
SMALLEST_SHARE = 0.02
# Depth of a view that is nearer than a part by more than this factor belongs to something in front.
IN_FRONT = 1.1


@dataclass(frozen=True)
class PartViews:
    """A photo's pixels of the parts, rendered by each geometry and rule.

    Attributes:
        shown: ``(H, W)`` pixels that show the parts and that all geometries and rules cover.
        share: share of the photo that shows the parts.
        images: (geometry, rule) -> ``(H, W, 3)`` RGB; zero at other pixels.
    """

    shown: BoolArray
    share: float
    images: dict[tuple[str, str], ImageArray]


@dataclass(frozen=True)
class ViewDependence:
    """PSNR on the parts, for the photos of one held-out set that show enough of them.

    Attributes:
        name: name of the set.
        photos: numbers of these photos in the set, ``F`` of them.
        psnr_db: (geometry, rule) -> ``(F,)`` PSNR (dB) after fitting one brightness factor.
    """

    name: str
    photos: tuple[int, ...]
    psnr_db: dict[tuple[str, str], FloatArray]

    def mean(self, geometry: str, rule: str) -> float:
        """Mean PSNR (dB) over the photos."""
        return float(self.psnr_db[geometry, rule].mean())

    def advantage(self, geometry: str) -> float:
        """Mean PSNR (dB) of the light field minus that of the better texture."""
        textures = (self.mean(geometry, rule) for rule in RULES if rule != "light_field")
        return self.mean(geometry, "light_field") - max(textures)

    def photos_better_over_own_depth(self) -> int:
        """Number of photos that the light field shows better over its own than over true depth."""
        own, true = self.psnr_db["own", "light_field"], self.psnr_db["true", "light_field"]
        return int(np.count_nonzero(own > true))


def measure(
    name: str,
    held_out: Iterator[HeldOut],
    held_out_true: Iterator[HeldOut],
    count: int,
    plane: Plane,
    parts: Sequence[FlatPart],
    progress: Progress,
) -> ViewDependence:
    """Compares all geometries and rules on the photos of one set.

    Args:
        name: name of the set.
        held_out: photos, with the light field over its own depth maps.
        held_out_true: the same photos, with the parts' true depth by ``with_true_depth``.
        count: number of the photos.
        plane: the scene's plane.
        parts: rectangles on which views are compared.
        progress: wraps the loop over photos to report progress.

    Raises:
        StageError: no photo shows enough of the parts.
    """
    numbers: list[int] = []
    values: dict[tuple[str, str], list[float]] = {}
    pairs = progress(zip(held_out, held_out_true, strict=True), f"compare {name}", count)
    for number, (photo, photo_true) in enumerate(pairs):
        views = part_views(photo, photo_true.views, plane, parts, STEP)
        if views.share < SMALLEST_SHARE or not views.shown.any():
            continue
        numbers.append(number)
        for key, image in views.images.items():
            values.setdefault(key, []).append(psnr(image, photo.image, views.shown))
    if not numbers:
        raise StageError(f"no photo of {name} shows the parts")
    measured = {key: np.array(of, dtype=np.float64) for key, of in values.items()}
    return ViewDependence(name, tuple(numbers), measured)


def part_views(
    photo: HeldOut, true_views: Views, plane: Plane, parts: Sequence[FlatPart], step: int
) -> PartViews:
    """Renders a photo's pixels of the parts by all geometries and rules.

    Args:
        photo: the photo, with the light field over its own depth maps.
        true_views: that light field with the true depth of the parts.
        plane: the scene's plane.
        parts: rectangles on which views are compared.
        step: one in this many rows and columns is rendered.
    """
    pose, intrinsics = photo.world_from_camera, photo.intrinsics
    shows_part = parts_inverse_depth(parts, pose, intrinsics) > 0.0
    share = float(shows_part.mean())
    chosen = np.zeros_like(shows_part)
    chosen[::step, ::step] = shows_part[::step, ::step]
    pixels = np.argwhere(chosen)[:, ::-1].astype(np.float64)
    images: dict[tuple[str, str], ImageArray] = {}
    shown = chosen.copy()
    surfaces = {
        "own": (photo.views, Quality.FINE),
        "true": (true_views, Quality.FINE),
        "plane": (without_depth(photo.views), Quality.PLANE),
    }
    for geometry, (views, quality) in surfaces.items():
        renderer = Renderer(views, plane, Blending.UNSTRUCTURED, quality)
        rendering = renderer.render_with_surface(pose, intrinsics)
        images[geometry, "light_field"] = np.rint(rendering.image).astype(np.uint8)
        usable = np.ones(len(views), dtype=bool)
        if quality is Quality.PLANE:
            usable = plane.signed_distance(views.centres) > 0.0
        inverse_depth = rendering.inverse_depth[chosen].astype(np.float64)
        colours = texture_colours(views, usable, pixels, inverse_depth, pose, intrinsics)
        shown &= rendering.covered
        shown[chosen] &= colours.seen_by > 0
        for rule, of in (("mean", colours.mean), ("median", colours.median)):
            image = np.zeros_like(photo.image)
            image[chosen] = np.rint(of).astype(np.uint8)
            images[geometry, rule] = image
    return PartViews(shown, share, images)


def with_true_depth(
    views: Views, world_from_camera: FloatArray, parts: Sequence[FlatPart]
) -> Views:
    """A light field with the parts' true depth where its photos show them.

    Depth that is clearly nearer belongs to something in front of a part and is kept.

    Args:
        views: the photos with their depth maps.
        world_from_camera: ``(N, 4, 4)`` poses of the photos.
        parts: rectangles whose depth is known.
    """
    maps = []
    for view, pose in enumerate(world_from_camera):
        own = views.depth_map(view)
        pinhole = views.intrinsics[view].resized(own.shape[1], own.shape[0])
        true = parts_inverse_depth(parts, pose, pinhole)
        replaced = (true > 0.0) & (own < IN_FRONT * true)
        maps.append(np.where(replaced, true, own).astype(np.float32))
    return with_depth(views, maps)
