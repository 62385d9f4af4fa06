"""A renderer on the device that was asked for: the CPU or a GPU."""

import logging
from collections.abc import Callable

from pipelines.artifacts.arguments import checked_instance
from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import OptionError, StageError
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views, views_of_scene
from pipelines.render.area_renderers import colour_renderers
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
        largest_side: photos are area-averaged to so many pixels at most; None: as recorded.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        threads: of the work on the CPU; None: one a processor.
        device: where views are rendered and compared. ``AUTO`` falls back to the CPU where the GPU
            cannot hold the photos, and logs a warning.
        views: the scene's photos in other channels, which are rendered in their place; None: they
            are rendered in colours.

    Raises:
        OptionError: no threads, a side without pixels, a quality that needs depth maps where there
            are none, or a device that does not exist; an argument of another type.
        InputError: a photo of the scene cannot be decoded.
        StageError: the GPU cannot do it, and ``GPU`` was asked for.
    """
    checked_instance(scene, "the scene", Scene)
    gpu = chosen_gpu(checked_instance(device, "device", Device))
    if views is None:
        views = views_of_scene(scene, largest_side)
    if gpu is not None:
        # wgpu is an optional dependency.
        from pipelines.render.gpu_renderer import GpuRenderer

        try:
            return GpuRenderer(views, scene.plane_if_any, blending, quality, threads, gpu=gpu)
        except StageError as error:
            if device is not Device.AUTO:
                raise
            logger.warning("rendering on the CPU, since %s", error)
    return Renderer(views, scene.plane_if_any, blending, quality, threads)


def renderers_of(
    scene: Scene | OpenWorld,
    largest_side: int | None,
    blending: Blending,
    quality: Quality,
    device: Device = Device.CPU,
) -> Callable[[FloatArray], Renderer]:
    """What says which renderer shows, in colours, what is seen from a pose ``(4, 4)``.

    Args:
        scene: the light field, or a world of several, whose areas are opened as poses need them.
        largest_side: photos are area-averaged to so many pixels at most; None: as recorded.
        blending: the rule that chooses and weights the views.
        quality: how finely the surface follows the views' depth maps.
        device: where a scene is rendered; a world is on the CPU.

    Raises:
        OptionError: a world on a GPU, or an area too large to be opened; as ``renderer_of_scene``.
        InputError, StageError: as ``renderer_of_scene``.
    """
    if isinstance(scene, OpenWorld):
        if device is Device.GPU:
            raise OptionError("a world of areas is rendered on the CPU, not on a GPU")
        return colour_renderers(scene, largest_side, blending, quality)
    renderer = renderer_of_scene(scene, largest_side, blending, quality, device=device)
    return lambda _: renderer
