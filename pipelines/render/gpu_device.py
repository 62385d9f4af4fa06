"""GPUs through wgpu (Vulkan, Metal, DX12), without a window: opening, buffers, textures.

Only this module and its neighbours ``gpu_*`` use wgpu; they are imported when a GPU is asked for.
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
# Adapter types, best first; other types (virtual, unknown) come after these and before SOFTWARE.
PREFERRED = ("DiscreteGPU", "IntegratedGPU")
SOFTWARE = "CPU"
# Limits that are raised to what the GPU has; of all others the defaults are enough.
LIMITS = (
    "max-buffer-size",
    "max-storage-buffer-binding-size",
    "max-texture-array-layers",
    "max-texture-dimension-2d",
    "max-compute-workgroups-per-dimension",
)
# Bytes: a bound buffer holds at least one element, none of which is larger than the first number;
# sizes are multiples of the second, four words.
SMALLEST_BUFFER, UNIT_BYTES = 256, 16

LONGEST_REASON = 200  # characters

STORAGE = wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_DST | wgpu.BufferUsage.COPY_SRC
UNIFORM = wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST


@dataclass(frozen=True)
class Gpu:
    """An open GPU.

    Attributes:
        device: wgpu's device.
        name: names of the GPU and of its interface.
        is_software: whether it is a software adapter, which runs on the CPU.
        limits: wgpu's name of a limit -> its value.
        programs: source text -> the programs compiled from it, by entry point.
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
        accept_software: whether a software adapter may be opened.

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
        with gpu_errors():
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
    """Sets XDG_RUNTIME_DIR, without which drivers complain when they look for a display."""
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
def gpu_errors() -> Iterator[None]:
    """Turns errors of the GPU into one line.

    Raises:
        StageError: no memory, a lost device, or a program that is refused.
    """
    try:
        yield
    except wgpu.GPUOutOfMemoryError as error:
        raise StageError("the GPU's memory is full; use smaller photos or device cpu") from error
    except (wgpu.GPUError, RuntimeError) as error:
        # Several lines, the cause last.
        reason = " ".join(str(error).split())[-LONGEST_REASON:] or type(error).__name__
        raise StageError(f"the GPU failed ({reason}); use device cpu") from error


def upload(gpu: Gpu, values: NDArray[Any]) -> Any:
    """A storage buffer with these values."""
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
    """Writes one layer of a texture.

    Args:
        gpu: which has the texture.
        texture: of several layers.
        layer: which of them.
        pixels: ``(height, width, ...)`` in the texture's format.
    """
    height, width = pixels.shape[:2]
    gpu.device.queue.write_texture(
        {"texture": texture, "origin": (0, 0, layer)},
        np.ascontiguousarray(pixels),
        {"bytes_per_row": pixels.nbytes // height, "rows_per_image": height},
        (width, height, 1),
    )


def layers_of(texture: Any) -> Any:
    """The view of a texture as an array of layers, even if there is but one."""
    return texture.create_view(dimension="2d-array")


class Scratch:
    """Scratch buffers, kept from call to call and only ever enlarged."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self._buffers: dict[str, Any] = {}

    def buffer(self, name: str, size: int, usage: int = STORAGE) -> Any:
        """A buffer of this name of at least so many bytes; its earlier content may be lost."""
        size = max(-(-size // UNIT_BYTES) * UNIT_BYTES, SMALLEST_BUFFER)
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
    """A compiled entry point and the layout of its bindings."""

    pipeline: Any
    layout: Any


def bind(gpu: Gpu, program: Program, resources: Sequence[Any]) -> Any:
    """Binds buffers and texture views to a program's bindings 0, 1, 2, ..."""
    entries = [
        {
            "binding": binding,
            "resource": resource
            if isinstance(resource, wgpu.GPUTextureView)
            else {"buffer": resource, "offset": 0, "size": resource.size},
        }
        for binding, resource in enumerate(resources)
    ]
    return gpu.device.create_bind_group(layout=program.layout, entries=entries)
