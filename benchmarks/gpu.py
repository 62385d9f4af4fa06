"""The GPU: particles a second, beside the CPU path and the GPU's own texture rate.

Everything is counted that a frame needs: poses and camera image go to the GPU, costs come back.
The yardstick is a shader that does nothing but read texels, in neighbourhoods of four as bilinear
sampling does; the share of it says how near the comparison is to the GPU's limit. A software
adapter has no speed worth a figure: with one, only the agreement with the CPU path is measured.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.scenes import with_wall_as_depth
from benchmarks.timing import markdown_table, median_times
from pipelines.artifacts.arrays import FloatArray, ImageArray
from pipelines.artifacts.errors import LfnavError, StageError
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.plane import plane_inverse_depth
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import views_of_scene
from pipelines.render.blending import unstructured_weights
from pipelines.render.choices import Blending, Cost, Quality
from pipelines.render.devices import Device, chosen_gpu
from pipelines.render.renderer import Renderer
from pipelines.render.view_mapping import ViewMapping

if TYPE_CHECKING:
    from pipelines.render.gpu_device import Gpu
    from pipelines.render.gpu_renderer import GpuRenderer

WIDTH, HEIGHT = 40, 30
FRAME, MANY = 195, 100_000
# The CPU path takes as long a particle whether there are so many or more.
CPU_PARTICLES = 10_000
AGREEMENT_PARTICLES = 1_000
TURNS = 7
Way = tuple[Blending, Quality]
USUAL = (Blending.UNSTRUCTURED, Quality.PLANE)
WAYS = {
    "plane": USUAL,
    "plane, Delaunay mesh": (Blending.DELAUNAY, Quality.PLANE),
    "depth maps": (Blending.UNSTRUCTURED, Quality.MEDIUM),
    "depth maps, Delaunay mesh": (Blending.DELAUNAY, Quality.MEDIUM),
}
COST, FIT_GAIN = Cost.ROBUST, True
# Poses of which the texel reads are counted; they differ little.
COUNTED_POSES = 20

# Both powers of two.
TEXTURE_SIDE, TEXTURE_LAYERS = 256, 32
STEPS, LANES = 256, 64
# By so many workgroups: a billion and more reads, some milliseconds of a fast GPU.
GROUPS = 256
READER = """
@group(0) @binding(0) var texels: texture_2d_array<u32>;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(64)
fn read(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
  var sum = vec4(0u);
  var place = vec2(group.x * 8u + lane % 8u, group.y * 8u + lane / 8u);
  for (var step = 0u; step < STEPS; step++) {
    let first = place & vec2(SIDE - 1u);
    let last = (place + 1u) & vec2(SIDE - 1u);
    let layer = (group.x + step / 8u) & (LAYERS - 1u);
    sum += textureLoad(texels, first, layer, 0);
    sum += textureLoad(texels, vec2(last.x, first.y), layer, 0);
    sum += textureLoad(texels, vec2(first.x, last.y), layer, 0);
    sum += textureLoad(texels, last, layer, 0);
    place += vec2(1u, 3u);
  }
  sums[(group.y * GROUPS + group.x) * 64u + lane] = sum.x + sum.y + sum.z + sum.w;
}
"""


@dataclass(frozen=True)
class Work:
    """Particles that look at the scene from around its photos.

    Attributes:
        scene: the light field.
        poses: ``(M, 4, 4)`` world_from_camera.
        intrinsics: of the virtual cameras.
        query: ``(H, W, 3)`` the camera image.
    """

    scene: Scene
    poses: FloatArray
    intrinsics: Intrinsics
    query: ImageArray


def work_of(scene: Scene, count: int) -> Work:
    """The task with so many particles."""
    rng = np.random.default_rng(0)
    poses = scene.world_from_camera[rng.integers(0, len(scene), count)].copy()
    poses[:, :3, 3] += rng.normal(0.0, 0.1, (count, 3))
    intrinsics = scene.camera_of(0).intrinsics.resized(WIDTH, HEIGHT)
    query = Renderer.of_scene(scene, 4 * WIDTH).render(poses[0], intrinsics).image
    return Work(scene, poses, intrinsics, query)


def gpu_renderer(work: Work, gpu: "Gpu", way: Way = USUAL) -> "GpuRenderer":
    """What localization makes of the scene, on the GPU."""
    from pipelines.render.gpu_renderer import GpuRenderer

    views = views_of_scene(work.scene, 4 * WIDTH)
    return GpuRenderer(views, work.scene.plane, *way, gpu=gpu)


def cpu_renderer(work: Work, way: Way = USUAL) -> Renderer:
    """The same on all processors."""
    return Renderer(views_of_scene(work.scene, 4 * WIDTH), work.scene.plane, *way)


def scored(renderer: Renderer, work: Work, count: int) -> FloatArray:
    """Costs of the first so many particles."""
    return renderer.costs(work.poses[:count], work.intrinsics, work.query, COST, FIT_GAIN)


def reads_per_particle(renderer: Renderer, work: Work) -> float:
    """Texels that one particle needs on average: four for each view that a pixel blends."""
    count = 0
    if renderer.plane is None:
        raise StageError("the benchmark counts reads over a plane, and the scene has none")
    usable = renderer.plane.signed_distance(renderer.views.centres) > 0.0
    for pose in work.poses[:COUNTED_POSES]:
        surface = plane_inverse_depth(renderer.plane, pose, work.intrinsics)
        mapping = ViewMapping.of(renderer.views, pose, work.intrinsics)
        found = unstructured_weights(renderer.views, usable, mapping, surface)
        count += int(np.count_nonzero(found.weights > 0.0))
    return 4.0 * count / min(COUNTED_POSES, len(work.poses))


def texture_rate(gpu: "Gpu", groups: int) -> float:
    """Texels a second that the GPU reads when it does nothing else; ``groups``^2 workgroups."""
    from pipelines.render.gpu_device import (
        Program,
        Scratch,
        bind,
        fill_layer,
        layers_of,
        read_back,
        texture_array,
    )

    device = gpu.device
    constants = {
        "SIDE": TEXTURE_SIDE,
        "LAYERS": TEXTURE_LAYERS,
        "STEPS": STEPS,
        "GROUPS": groups,
    }
    declared = "".join(f"const {name}: u32 = {value}u;\n" for name, value in constants.items())
    module = device.create_shader_module(code=declared + READER)
    pipeline = device.create_compute_pipeline(
        layout="auto", compute={"module": module, "entry_point": "read"}
    )
    program = Program(pipeline, pipeline.get_bind_group_layout(0))
    texture = texture_array(gpu, "rgba8uint", TEXTURE_SIDE, TEXTURE_SIDE, TEXTURE_LAYERS)
    rng = np.random.default_rng(0)
    for layer in range(TEXTURE_LAYERS):
        texels = rng.integers(0, 256, (TEXTURE_SIDE, TEXTURE_SIDE, 4)).astype(np.uint8)
        fill_layer(gpu, texture, layer, texels)
    sums = Scratch(gpu).buffer("sums", 4 * groups * groups * LANES)
    group = bind(gpu, program, [layers_of(texture), sums])

    def run() -> None:
        encoder = device.create_command_encoder()
        work = encoder.begin_compute_pass()
        work.set_pipeline(pipeline)
        work.set_bind_group(0, group)
        work.dispatch_workgroups(groups, groups)
        work.end()
        device.queue.submit([encoder.finish()])
        # The GPU has finished when a number comes back.
        read_back(gpu, sums, 1)

    return 4 * STEPS * LANES * groups * groups / seconds(run)


def seconds(work: Callable[[], object]) -> float:
    """Median wall time."""
    return median_times({"work": work}, TURNS)["work"].wall


def agreement(work: Work, gpu: "Gpu") -> dict[str, dict[str, float]]:
    """Differences of costs between GPU and CPU, by rule and surface: median and largest."""
    result = {}
    deep = replace(work, scene=with_wall_as_depth(work.scene))
    count = min(AGREEMENT_PARTICLES, len(work.poses))
    for name, way in WAYS.items():
        found = scored(gpu_renderer(deep, gpu, way), deep, count)
        difference = np.abs(found - scored(cpu_renderer(deep, way), deep, count))
        result[name] = {"median": float(np.median(difference)), "largest": float(difference.max())}
    return result


def speed(
    cpu: Renderer, on_gpu: "GpuRenderer", work: Work, counts: tuple[int, int, int], groups: int
) -> dict[str, float]:
    """Figures of a real GPU.

    Args:
        cpu: the CPU path, on all processors.
        on_gpu: the same on the GPU.
        work: with as many particles as the largest count.
        counts: particles of a frame, of the large batch, and of the CPU path.
        groups: of the yardstick, see ``texture_rate``.
    """
    frame, many, on_cpu = counts
    frame_seconds = seconds(lambda: scored(on_gpu, work, frame))
    many_seconds = seconds(lambda: scored(on_gpu, work, many))
    cpu_seconds = seconds(lambda: scored(cpu, work, on_cpu))
    rate = texture_rate(on_gpu.gpu, groups)
    needed = reads_per_particle(cpu, work) * many / many_seconds
    return {
        "frame_ms": 1e3 * frame_seconds,
        "frame_particles_per_second": frame / frame_seconds,
        "particles_per_second": many / many_seconds,
        "times_cpu": (many / many_seconds) / (on_cpu / cpu_seconds),
        "texels_per_second": rate,
        "share_of_texture_rate": needed / rate,
    }


def measure(scene: Scene) -> dict[str, Any]:
    """The GPU's figures; of a software adapter only how well it agrees; why there are none."""
    try:
        gpu = chosen_gpu(Device.GPU)
    except LfnavError as error:
        return {"gpu": {"device": None, "reason": str(error)}}
    if gpu is None:
        return {"gpu": {"device": None, "reason": "no adapter"}}
    work = work_of(scene, AGREEMENT_PARTICLES if gpu.is_software else MANY)
    figures: dict[str, Any] = {
        "device": gpu.name,
        "is_software": gpu.is_software,
        "size": f"{WIDTH}x{HEIGHT}",
        "views": len(scene),
        "differences": agreement(work, gpu),
    }
    if not gpu.is_software:
        cpu, on_gpu = cpu_renderer(work), gpu_renderer(work, gpu)
        figures |= speed(cpu, on_gpu, work, (FRAME, MANY, CPU_PARTICLES), GROUPS)
    return {"gpu": figures}


def table(results: dict[str, Any]) -> str:
    """The figures for people."""
    if results["device"] is None:
        return f"No GPU was measured: {results['reason']}"
    rows = [
        (f"{name}: costs off the CPU's by", f"{of['median']:.0e}, at most {of['largest']:.0e}")
        for name, of in results["differences"].items()
    ]
    if results["is_software"]:
        rows.append(("speed", "not measured: this is a software adapter, no GPU"))
    else:
        rows += [
            (f"{FRAME} particles, upload and read-back included", f"{results['frame_ms']:.2f} ms"),
            (f"particles a second, {MANY}", f"{results['particles_per_second']:.3g}"),
            ("times the CPU path, all processors", f"{results['times_cpu']:.0f}"),
            ("texels a second, nothing but reads", f"{results['texels_per_second']:.3g}"),
            ("share of that", f"{results['share_of_texture_rate']:.0%}"),
        ]
    return markdown_table((f"{results['device']}, {results['size']}", ""), rows)
