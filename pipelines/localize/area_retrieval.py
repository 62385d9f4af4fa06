"""Which areas of a world may an image have been taken in? The coarse step of localization.

Small versions of all photos of the world, in the channels in which images are compared, are ranked
by how much they look like the image (``retrieval``).
"""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import Float32Array, IntArray
from pipelines.geometry.camera import Intrinsics
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.views import area_average, views_of_scene
from pipelines.localize.observation import Observation
from pipelines.localize.retrieval import RetrievalIndex, index_of_images
from pipelines.localize.state_space import StateSpace
from pipelines.render.channels import channel_image
from pipelines.render.choices import Channels

# Photos are decoded to so many times the width at which they are compared.
DECODED_FACTOR = 4


@dataclass(frozen=True)
class LikelyArea:
    """An area that may hold the body.

    Attributes:
        area: its number.
        score: how much its likeliest photo looks like the image; comparable for one image.
    """

    area: int
    score: float


class AreaRetrieval:
    """Ranks areas by how much their photos look like an image.

    Args:
        world: the areas.
        space: what a state is.
        channels: in which images are compared.
        intrinsics: of the images that will be ranked.
    """

    def __init__(
        self, world: OpenWorld, space: StateSpace, channels: Channels, intrinsics: Intrinsics
    ) -> None:
        size = (intrinsics.width, intrinsics.height)
        home = world.index.home
        images: dict[int, Float32Array] = {}
        for area in range(len(world.index.areas)):
            own = np.flatnonzero(home == area).tolist()
            held = set(world.index.areas[area].views.tolist())
            for photos, scene in world.scenes(area, [photo for photo in own if photo in held]):
                views = views_of_scene(scene, DECODED_FACTOR * size[0])
                for number, photo in enumerate(photos):
                    small = area_average(views.level(number, 0), *size)
                    images[photo] = channel_image(small, channels)
        self._photos: IntArray = np.array(sorted(images), dtype=np.int64)
        self._home = home[self._photos]
        self._channels = channels
        covered = np.ones((len(images), size[1], size[0]), dtype=np.bool_)
        states = space.states(world.world_from_camera[self._photos])
        stacked = np.stack([images[photo] for photo in self._photos.tolist()])
        self._index: RetrievalIndex = index_of_images(states, stacked, covered, intrinsics)

    def __call__(self, observation: Observation) -> list[LikelyArea]:
        """The areas, the likeliest first.

        Args:
            observation: the image, as wide as was said.
        """
        scores = self._index.scores(observation.in_channels(self._channels))
        best = {int(area): float(scores[self._home == area].max()) for area in set(self._home)}
        ranked = sorted(best.items(), key=lambda found: (-found[1], found[0]))
        return [LikelyArea(area, score) for area, score in ranked]
