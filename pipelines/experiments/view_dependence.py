"""What view-dependent appearance is worth: a light field beside a view-independent texture.

On surfaces that mirror, what a point looks like depends on where one stands. A texture has one
colour a point; a light field shows each point as the photos taken from near the virtual camera saw
it. Both are compared on flat parts of a scene that are known exactly, over the same geometry, with
photos that the scene does not hold. The geometry is the depth found from the photos, the true depth
of the parts, and the scene's plane: a mirror image has a depth of its own, behind the surface, so
that the true depth need not be the best.
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
# Every so many rows and columns of a photo count: neighbouring pixels say the same.
STEP = 2
# A photo counts when the parts fill at least this share of it.
SMALLEST_SHARE = 0.02
# What a view sees so many times nearer than a part stands before it and keeps its depth.
IN_FRONT = 1.1


@dataclass(frozen=True)
class PartViews:
    """What each geometry and rule shows at the pixels of a photo that look at the parts.

    Attributes:
        shown: ``(H, W)`` those pixels, as far as all of them cover them.
        share: of the photo that looks at the parts.
        images: (geometry, rule) -> ``(H, W, 3)`` RGB; zero elsewhere.
    """

    shown: BoolArray
    share: float
    images: dict[tuple[str, str], ImageArray]


@dataclass(frozen=True)
class ViewDependence:
    """PSNR on the parts, for the photos of one held-out set that show enough of them.

    Attributes:
        name: of the set.
        photos: ``(F,)`` their numbers in the set.
        psnr_db: (geometry, rule) -> ``(F,)``, each after one brightness factor.
    """

    name: str
    photos: tuple[int, ...]
    psnr_db: dict[tuple[str, str], FloatArray]

    def mean(self, geometry: str, rule: str) -> float:
        """Mean PSNR (dB) over the photos."""
        return float(self.psnr_db[geometry, rule].mean())

    def advantage(self, geometry: str) -> float:
        """How much better (dB) the light field is than the better of the textures."""
        textures = (self.mean(geometry, rule) for rule in RULES if rule != "light_field")
        return self.mean(geometry, "light_field") - max(textures)

    def photos_better_over_own_depth(self) -> int:
        """How many photos the light field shows better over its own than over the true depth."""
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
        name: of the set, for people.
        held_out: photos with the light field over its own depth maps.
        held_out_true: the same with the parts' true depth, see ``with_true_depth``.
        count: number of the photos.
        plane: the scene's plane.
        parts: where the comparison is made.
        progress: told how far the work is.

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
    """Renders one photo's pixels of the parts over all geometries by all rules.

    Args:
        photo: with the light field over its own depth.
        true_views: that light field with the true depth of the parts.
        plane: the scene's plane.
        parts: rectangles.
        step: every so many rows and columns are looked at.
    """
    pose, intrinsics = photo.world_from_camera, photo.intrinsics
    looked_at = parts_inverse_depth(parts, pose, intrinsics) > 0.0
    share = float(looked_at.mean())
    chosen = np.zeros_like(looked_at)
    chosen[::step, ::step] = looked_at[::step, ::step]
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
    """The same light field with the parts' true depth where its photos show them.

    Depth that is clearly nearer is kept: something stands before the part.

    Args:
        views: with depth maps.
        world_from_camera: ``(N, 4, 4)`` their poses.
        parts: rectangles.
    """
    maps = []
    for view, pose in enumerate(world_from_camera):
        own = views.depth_map(view)
        pinhole = views.intrinsics[view].resized(own.shape[1], own.shape[0])
        true = parts_inverse_depth(parts, pose, pinhole)
        replaced = (true > 0.0) & (own < IN_FRONT * true)
        maps.append(np.where(replaced, true, own).astype(np.float32))
    return with_depth(views, maps)
