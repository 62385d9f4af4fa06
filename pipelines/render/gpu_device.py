"""Graphics cards through wgpu (Vulkan, Metal, DX12), without a window: opening, buffers, textures.

The only module, with its neighbours ``gpu_*``, that knows wgpu; imported when a card is asked for.
"""

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import wgpu
from numpy.typing import NDArray

from pipelines.artifacts.errors import StageError

BACKENDS = ("Vulkan", "Metal", "D3D12")
# From the best on; other types (virtual, unknown) come between.
PREFERRED = ("DiscreteGPU", "IntegratedGPU")
SOFTWARE = "CPU"
# As much of these as the card has; of all others what every card has is enough.
LIMITS = (
    "max-buffer-size",
    "max-storage-buffer-binding-size",
    "max-texture-array-layers",
    "max-texture-dimension-2d",
    "max-compute-workgroups-per-dimension",
)
# What is bound holds at least one element: none is larger than this. Sizes are multiples of words.
SMALLEST_BUFFER, WORD_OF_FOUR = 256, 16

LONGEST_REASON = 200  # characters

STORAGE = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_DST | wgpu.BufferUsage.COPY_SRC
UNIFORM = wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST


@dataclass(frozen=True)
class Gpu:
    """An open graphics card.

    Attributes:
        device: wgpu's device.
        name: the card's and its interface's names.
        is_software: whether it is no card but a program on the CPU.
        limits: wgpu's names of limits and their values.
        programs: what was compiled for it, by source text.
    """

    device: Any
    name: str
    is_software: bool
    limits: Mapping[str, int]
    programs: dict[str, dict[str, "Program"]] = field(default_factory=dict)

    @property
    def largest_binding(self) -> int:
        """Bytes of the largest buffer that a program can take."""
        return min(self.limits["max-storage-buffer-binding-size"], self.limits["max-buffer-size"])


def open_gpu(accept_software: bool) -> Gpu | None:
    """Opens the best adapter; None where there is none.

    Args:
        accept_software: whether an adapter that is a program on the CPU counts.

    Raises:
        StageError: the adapter does not open.
    """
    with _quiet_windowing():
        adapters = [
            adapter
            for adapter in wgpu.gpu.enumerate_adapters_sync()
            if adapter.info["backend_type"] in BACKENDS
            and (accept_software or adapter.info["adapter_type"] != SOFTWARE)
        ]
        if not adapters:
            return None
        adapter = min(adapters, key=_rank)
        with card_errors():
            wanted = {name: adapter.limits[name] for name in LIMITS}
            device = adapter.request_device_sync(required_limits=wanted)
    info = adapter.info
    return Gpu(
        device=device,
        name=f"{info['device']} ({info['backend_type']})",
        is_software=info["adapter_type"] == SOFTWARE,
        limits={name: int(device.limits[name]) for name in LIMITS},
    )


def _rank(adapter: Any) -> int:
    kind = adapter.info["adapter_type"]
    if kind in PREFERRED:
        return PREFERRED.index(kind)
    return len(PREFERRED) + int(kind == SOFTWARE)


@contextmanager
def _quiet_windowing() -> Iterator[None]:
    """Drivers look for a display where XDG_RUNTIME_DIR says, and complain where it says nothing."""
    name = "XDG_RUNTIME_DIR"
    if name in os.environ:
        yield
        return
    os.environ[name] = tempfile.gettempdir()
    try:
        yield
    finally:
        del os.environ[name]


@contextmanager
def card_errors() -> Iterator[None]:
    """What fails on the card becomes one line.

    Raises:
        StageError: no memory, a lost device, a program that it refuses.
    """
    try:
        yield
    except wgpu.GPUOutOfMemoryError as error:
        raise StageError(
            "the graphics card's memory is full; use smaller photos or device cpu"
        ) from error
    except (wgpu.GPUError, RuntimeError) as error:
        # Several lines, the cause last.
        reason = " ".join(str(error).split())[-LONGEST_REASON:] or type(error).__name__
        raise StageError(f"the graphics card failed ({reason}); use device cpu") from error


def upload(gpu: Gpu, values: NDArray[Any]) -> Any:
    """A buffer that programs read, with these values."""
    data = np.ascontiguousarray(values).tobytes()
    data += bytes(max(SMALLEST_BUFFER - len(data), 0))
    return gpu.device.create_buffer_with_data(data=data, usage=STORAGE)


def texture_array(gpu: Gpu, pixel_format: str, width: int, height: int, layers: int) -> Any:
    """An empty texture of several layers that programs read."""
    return gpu.device.create_texture(
        size=(width, height, layers),
        format=pixel_format,
        usage=wgpu.TextureUsage.TEXTURE_BINDING | wgpu.TextureUsage.COPY_DST,
    )


def fill_layer(gpu: Gpu, texture: Any, layer: int, pixels: NDArray[Any]) -> None:
    """Writes one layer: ``(height, width, ...)`` of the texture's format."""
    height, width = pixels.shape[:2]
    gpu.device.queue.write_texture(
        {"texture": texture, "origin": (0, 0, layer)},
        np.ascontiguousarray(pixels),
        {"bytes_per_row": pixels.nbytes // height, "rows_per_image": height},
        (width, height, 1),
    )


def layers_of(texture: Any) -> Any:
    """How programs see a texture of several layers, even if there is but one."""
    return texture.create_view(dimension="2d-array")


class Scratch:
    """Buffers that programs write, kept from call to call and only ever made larger."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self._buffers: dict[str, Any] = {}

    def buffer(self, name: str, size: int, usage: int = STORAGE) -> Any:
        """A buffer of this name of at least so many bytes; what was in it may be gone."""
        size = max(-(-size // WORD_OF_FOUR) * WORD_OF_FOUR, SMALLEST_BUFFER)
        found = self._buffers.get(name)
        if found is not None and found.size >= size:
            return found
        if found is not None:
            found.destroy()
        self._buffers[name] = self._gpu.device.create_buffer(size=size, usage=usage)
        return self._buffers[name]


def read_back(gpu: Gpu, buffer: Any, count: int) -> NDArray[np.float32]:
    """The first ``count`` single-precision numbers of a buffer."""
    data = gpu.device.queue.read_buffer(buffer, 0, 4 * count)
    return np.frombuffer(data, dtype=np.float32)


@dataclass(frozen=True)
class Program:
    """A compiled entry point and what it takes."""

    pipeline: Any
    layout: Any


def bind(gpu: Gpu, program: Program, resources: Sequence[Any]) -> Any:
    """Puts buffers and texture views at a program's places 0, 1, 2, ..."""
    entries = [
        {
            "binding": place,
            "resource": resource
            if isinstance(resource, wgpu.GPUTextureView)
            else {"buffer": resource, "offset": 0, "size": resource.size},
        }
        for place, resource in enumerate(resources)
    ]
    return gpu.device.create_bind_group(layout=program.layout, entries=entries)
