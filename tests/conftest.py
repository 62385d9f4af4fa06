"""What holds for all tests."""

from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from pipelines.render.gpu_device import Gpu

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
