"""Which device renders: the choice, its one-line refusals, and what the commands make of it."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.errors import OptionError
from pipelines.dataset.images import decode_image
from pipelines.lightfield.scene import Scene
from pipelines.localize.run import load_run
from pipelines.render.choices import Blending, Quality
from pipelines.render.devices import Device, chosen_gpu, resolved_device
from pipelines.render.renderer import Renderer
from pipelines.render.renderer_choice import renderer_of_scene
from tests.chain_samples import ELEVATORS, first_frames, lfnav, map_elevators, succeed

POSE = "-1.2,-2.0,90"


@pytest.fixture(scope="module")
def scene_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return map_elevators(tmp_path_factory.mktemp("elevators"), "--plane", "0,-1,0,0")


def assert_one_line(error: str, *parts: str) -> None:
    assert error.startswith("lfnav: ")
    assert error.count("\n") == 1
    for part in parts:
        assert part in error


def test_without_the_extra(
    scene_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wgpu", None)
    assert chosen_gpu(Device.AUTO) is None
    assert resolved_device(Device.AUTO) is Device.CPU
    with pytest.raises(OptionError, match="wgpu is missing"):
        chosen_gpu(Device.GPU)
    target = tmp_path / "view.png"
    command: list[str | Path] = ["render", scene_path, "--pose", POSE, "--width", "32"]
    command += ["-o", target, "--device"]
    refused = lfnav(*command, "gpu")
    assert refused.code == 1
    assert_one_line(refused.err, 'pip install "lfnav[gpu]"', "or choose device cpu")
    assert not target.exists()
    succeed(*command, "auto")
    assert target.exists()


def test_an_extra_whose_library_does_not_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "wgpu.py").write_text("raise OSError('libwgpu_native.so: cannot open')\n")
    monkeypatch.delitem(sys.modules, "wgpu", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    assert chosen_gpu(Device.AUTO) is None
    assert "libwgpu_native.so: cannot open" in caplog.text
    with pytest.raises(OptionError, match=r"libwgpu_native.so: cannot open.*reinstall it"):
        chosen_gpu(Device.GPU)


def adapters(*kinds: tuple[str, str]) -> SimpleNamespace:
    """A graphics library that finds adapters of these types and interfaces."""
    found = [
        SimpleNamespace(info={"adapter_type": kind, "backend_type": backend, "device": kind})
        for kind, backend in kinds
    ]
    return SimpleNamespace(enumerate_adapters_sync=lambda: found)


def opened(monkeypatch: pytest.MonkeyPatch, device: Device, *kinds: tuple[str, str]) -> str | None:
    """The adapter type that a choice opens."""
    wgpu = pytest.importorskip("wgpu", reason='no wgpu: pip install "lfnav[gpu]"')
    from pipelines.render import gpu_device

    requested = []

    def open_adapter(adapter: Any) -> Any:
        requested.append(adapter)
        limits = dict.fromkeys(gpu_device.LIMITS, 1)
        return SimpleNamespace(limits=limits)

    library = adapters(*kinds)
    for adapter in library.enumerate_adapters_sync():
        adapter.limits = dict.fromkeys(gpu_device.LIMITS, 1)
        adapter.request_device_sync = lambda required_limits, own=adapter: open_adapter(own)
    monkeypatch.setattr(wgpu, "gpu", library)
    gpu = chosen_gpu(device)
    if gpu is None:
        return None
    kind = str(requested[0].info["adapter_type"])
    assert gpu.is_software == (kind == "CPU")
    assert kind in gpu.name
    return kind


@pytest.mark.parametrize(
    ("found", "auto", "gpu"),
    [
        ([("CPU", "Vulkan")], None, "CPU"),
        ([("CPU", "Vulkan"), ("DiscreteGPU", "Vulkan")], "DiscreteGPU", "DiscreteGPU"),
        ([("IntegratedGPU", "D3D12"), ("DiscreteGPU", "D3D12")], "DiscreteGPU", "DiscreteGPU"),
        ([("Unknown", "Vulkan"), ("IntegratedGPU", "Metal")], "IntegratedGPU", "IntegratedGPU"),
        ([("CPU", "Vulkan"), ("Unknown", "Vulkan")], "Unknown", "Unknown"),
    ],
)
def test_the_best_card_is_taken_and_software_only_when_asked_for(
    found: list[tuple[str, str]], auto: str | None, gpu: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert opened(monkeypatch, Device.AUTO, *found) == auto
    assert opened(monkeypatch, Device.GPU, *found) == gpu
    assert opened(monkeypatch, Device.CPU, *found) is None


@pytest.mark.parametrize("found", [[], [("DiscreteGPU", "OpenGL")]])
def test_no_adapter(
    found: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch, scene_path: Path, tmp_path: Path
) -> None:
    assert opened(monkeypatch, Device.AUTO, *found) is None
    with pytest.raises(OptionError, match="no adapter"):
        opened(monkeypatch, Device.GPU, *found)
    run: list[str | Path] = ["localize", scene_path, ELEVATORS / "test", "-o", tmp_path / "run.h5"]
    refused = lfnav(*run, "--device", "gpu")
    assert refused.code == 1
    assert_one_line(refused.err, "no adapter for Vulkan, Metal or DX12", "or choose device cpu")
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.parametrize("command", ["render", "localize", "dock"])
def test_an_unknown_device_is_wrong_usage(command: str) -> None:
    refused = lfnav(command, "scene.h5", "-o", "x", "--device", "tpu")
    assert refused.code == 2
    assert_one_line(refused.err, "'tpu' is not one of 'auto', 'cpu', 'gpu'")


def test_rendering_on_the_gpu_from_the_shell(gpu: Any, scene_path: Path, tmp_path: Path) -> None:
    """A process of its own: drivers must not write to stderr, nor hold the process back."""
    command = ["render", str(scene_path), "--pose", POSE, "--width", "64"]
    by_cpu, by_gpu = tmp_path / "cpu.png", tmp_path / "gpu.png"
    succeed(*command, "-o", by_cpu, "--device", "cpu")
    program = "import sys; from lfnav_cli.main import run; sys.exit(run())"
    done = subprocess.run(
        [sys.executable, "-c", program, *command, "-o", str(by_gpu), "--device", "gpu"],
        cwd=Path(__file__).parents[2],
        env={name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    images = [decode_image(path.read_bytes(), path).astype(int) for path in (by_cpu, by_gpu)]
    assert np.abs(images[1] - images[0]).max() <= 1
    assert images[0].std() > 10.0


def test_localizing_on_the_gpu(gpu: Any, scene_path: Path, tmp_path: Path) -> None:
    data = first_frames(ELEVATORS / "test", tmp_path / "data", 2)
    command: list[str | Path] = ["localize", scene_path, data, "--quiet", "--start", "-1.7,-3.2,90"]
    command += ["--particles", "60", "--start-particles", "60"]
    runs = {}
    for name, device in (("a", "gpu"), ("b", "gpu"), ("c", "cpu"), ("d", "auto")):
        path = tmp_path / f"{name}.h5"
        succeed(*command, "-o", path, "--device", device)
        runs[name] = load_run(path)
    for first, second in zip(runs["a"].frames, runs["b"].frames, strict=True):
        np.testing.assert_array_equal(first.particles, second.particles)
        np.testing.assert_array_equal(first.log_weights, second.log_weights)
    difference = np.abs(runs["a"].frames[0].log_weights - runs["c"].frames[0].log_weights)
    assert np.mean(difference <= 0.05) > 0.99
    # Evidence is looked up in steps: rounding may move a pixel or two from one to the next.
    assert difference.max() < 0.2
    # The file says where it was computed.
    assert runs["a"].settings["device"] == "gpu"
    assert runs["c"].settings["device"] == "cpu"
    assert runs["d"].settings["device"] == ("cpu" if gpu.is_software else "gpu")


def test_docking_hands_the_device_on(scene_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pipelines.dock import stage

    def dock_robot(*arguments: Any, **_: Any) -> Any:
        raise OptionError(f"asked for {arguments[0].filter_settings.device}")

    monkeypatch.setattr(stage, "dock_robot", dock_robot)
    command: list[str | Path] = ["dock", scene_path, "--robot", f"model:{scene_path}"]
    command += ["--goal", "0,-2,90", "-o", "x.h5"]
    for options, device in (((), "cpu"), (("--device", "gpu"), "gpu")):
        assert_one_line(lfnav(*command, *options).err, f"asked for {device}")


def test_photos_too_large_for_the_gpu(
    gpu: Any, scene_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Asked for the GPU, that is an error; left to choose, the CPU does it and says so."""
    from dataclasses import replace

    from pipelines.lightfield.scene_file import load_scene
    from pipelines.render import gpu_device
    from pipelines.render.gpu_renderer import GpuRenderer

    small = replace(gpu, limits={**gpu.limits, "max-texture-dimension-2d": 64})
    monkeypatch.setattr(gpu_device, "open_gpu", lambda accept_software: small)
    scene = load_scene(scene_path)

    def renderer(scene: Scene, device: Device) -> Renderer:
        return renderer_of_scene(
            scene, 64, Blending.UNSTRUCTURED, Quality.PLANE, threads=1, device=device
        )

    assert not isinstance(renderer(scene, Device.AUTO), GpuRenderer)
    assert "rendering on the CPU, since" in caplog.text
    assert "do not fit" in caplog.text
    # The command line has a log of its own.
    refused = lfnav("render", scene_path, "--pose", POSE, "-o", "x.png", "--device", "gpu")
    assert refused.code == 1
    assert_one_line(refused.err, "photos", "do not fit", "device cpu")
