"""What holds for all tests."""

import os
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from pipelines.render.gpu_device import Gpu


def keep_to_one_processor(worker: str) -> None:
    """Of several test processes each has one: libraries start a thread for each that they may use.

    Before any of these libraries is imported. Which processors there are is known on Linux only.
    """
    if hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[int(worker.removeprefix("gw")) % len(allowed)]})


if "PYTEST_XDIST_WORKER" in os.environ:
    keep_to_one_processor(os.environ["PYTEST_XDIST_WORKER"])

# No test asserts a time: on a busy machine any example may take long.
settings.register_profile("lfnav", deadline=None)
settings.load_profile("lfnav")


@pytest.fixture(scope="session")
def gpu() -> "Gpu":
    """The best GPU; Mesa's software adapter will do."""
    pytest.importorskip("wgpu", reason='no wgpu: pip install "lfnav[gpu]"')
    from pipelines.render.gpu_device import open_gpu

    found = open_gpu(accept_software=True)
    if found is None:
        pytest.skip("no adapter for Vulkan, Metal or DX12: apt-get install mesa-vulkan-drivers")
    return found
