"""Where the light field is rendered: the choice between the CPU and a GPU.

No graphics library is loaded before a GPU is asked for.
"""

import logging
from enum import StrEnum
from typing import TYPE_CHECKING

from pipelines.artifacts.errors import OptionError, reason_of

if TYPE_CHECKING:
    from pipelines.render.gpu_device import Gpu

logger = logging.getLogger(__name__)


INSTALL = 'pip install "lfnav[gpu]"'


class Device(StrEnum):
    """Where the light field is rendered and compared.

    AUTO: on a GPU where there is one that lfnav can use, else on the CPU.
    CPU: on the CPU.
    GPU: on a GPU, or on the driver's software adapter where there is no other.
    """

    AUTO = "auto"
    CPU = "cpu"
    GPU = "gpu"


def resolved_device(device: Device) -> Device:
    """The device that a choice means on this machine: ``CPU`` or ``GPU``."""
    if device is not Device.AUTO:
        return device
    return Device.CPU if chosen_gpu(device) is None else Device.GPU


def chosen_gpu(device: Device) -> "Gpu | None":
    """Opens the GPU that a choice means; None: the CPU does the work.

    Raises:
        OptionError: ``GPU``, and the extra is not installed or there is no adapter.
        StageError: the GPU does not open.
    """
    if device is Device.CPU or not _is_installed(device):
        return None
    from pipelines.render.gpu_device import open_gpu

    gpu = open_gpu(accept_software=device is Device.GPU)
    if gpu is None and device is Device.GPU:
        raise OptionError(
            "device gpu: no adapter for Vulkan, Metal or DX12 here; install the GPU's driver "
            "(Debian's software adapter: mesa-vulkan-drivers), or choose device cpu"
        )
    logger.info("rendering on %s", "the CPU" if gpu is None else gpu.name)
    return gpu


def _is_installed(device: Device) -> bool:
    """Whether the graphics library loads.

    Raises:
        OptionError: ``GPU``, and it does not.
    """
    try:
        import wgpu  # noqa: F401
    except ModuleNotFoundError as error:
        if device is Device.GPU:
            raise OptionError(
                f"device gpu needs an extra that is not installed ({error.name} is missing); "
                f"install it with {INSTALL}, or choose device cpu"
            ) from error
        return False
    except (ImportError, OSError, RuntimeError) as error:
        if device is Device.GPU:
            raise OptionError(
                f"device gpu: wgpu is there but does not load ({reason_of(error)}); "
                f"reinstall it with {INSTALL}, or choose device cpu"
            ) from error
        logger.warning("wgpu is there but does not load (%s); rendering on the CPU", error)
        return False
    return True
