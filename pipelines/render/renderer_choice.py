"""A renderer on the device that was asked for: the CPU, or a graphics card."""

import logging

from pipelines.artifacts.errors import StageError
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene
from pipelines.render.choices import Blending, Quality
from pipelines.render.devices import Device, chosen_gpu
from pipelines.render.renderer import Renderer

logger = logging.getLogger(__name__)


def renderer_of_scene(
    scene: Scene,
    largest_side: int | None = None,
    blending: Blending = Blending.UNSTRUCTURED,
    quality: Quality = Quality.PLANE,
    threads: int | None = None,
    device: Device = Device.CPU,
    views: Views | None = None,
) -> Renderer:
    """A renderer of a scene's photos.

    Args:
        scene: the light field.
        largest_side: photos are area-averaged to so many pixels at most.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: of what runs on the CPU; None: one a processor.
        device: where views are rendered and compared. ``AUTO`` falls back to the CPU where the
            card cannot hold the photos, and says so.
        views: rendered in the place of the scene's own photos where they are given: the same photos
            in other channels.

    Raises:
        OptionError: as for ``Renderer``; a device that is not there.
        StageError: the card cannot do it, and ``GPU`` was asked for.
    """
    gpu = chosen_gpu(device)
    if views is None:
        views = views_of_scene(scene, largest_side)
    if gpu is not None:
        # An extra: nothing of it is loaded before it is asked for.
        from pipelines.render.gpu_renderer import GpuRenderer

        try:
            return GpuRenderer(views, scene.plane, blending, quality, threads, gpu=gpu)
        except StageError as error:
            if device is not Device.AUTO:
                raise
            logger.warning("rendering on the CPU, since %s", error)
    return Renderer(views, scene.plane, blending, quality, threads)
