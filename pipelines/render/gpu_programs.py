"""The programs that run on a GPU: WGSL files, constants from the Python side, entry points.

The constants of the rules (penalties, limits, costs of uncovered pixels) are defined in the modules
that explain them, and are put in front of the shaders' text.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import wgpu

from pipelines.lightfield import view_penalties
from pipelines.render import blending, comparison, delaunay_mesh, reference, surface
from pipelines.render.choices import Blending, Cost
from pipelines.render.gpu_device import Gpu, Program, gpu_errors

Constant = bool | int | float

# Entry points that make the tiles of the unstructured lumigraph, in this order.
TILE_STEPS = ("select_candidates", "weight_corners", "join_tiles")

# Kinds of a program's bindings 0, 1, 2, ..., as the shaders declare them.
SHARED = ("uniform", "read", "read", "depths")
VISIBILITY = (*SHARED, "write", "read")
DRAWING = (*SHARED, "write", "read", "read", "texels", "write")
COMPARISON = (*DRAWING, "read", "write")
SURFACE = (*SHARED, "read", "write", "write")


@dataclass(frozen=True)
class Programs:
    """Compiles the programs of one kind of light field.

    Attributes:
        gpu: for which they are compiled.
        rule: how views are blended.
        has_depth: whether the surface comes from depth maps.
    """

    gpu: Gpu
    rule: Blending
    has_depth: bool

    def drawing(self) -> dict[str, Program]:
        """The steps of rendering images: ``TILE_STEPS``, where there are tiles; then ``draw``."""
        names, entries = [*self._shading(), "drawing"], ["draw"]
        if self.rule is Blending.UNSTRUCTURED:
            names, entries = [*names, "tiles"], [*TILE_STEPS, *entries]
        return self._compiled(names, {}, DRAWING, entries)

    def comparison(self, cost: Cost, fit_gain: bool) -> Program:
        """Rendering and comparing, fused: ``compare``."""
        constants: dict[str, Constant] = {
            "KIND": int(cost),
            "FIT_GAIN": fit_gain,
            "TWO_PASSES": needs_two_passes(cost, fit_gain),
            **{kind.name: int(kind) for kind in Cost},
            **cost_constants(),
        }
        names = [*self._shading(), "comparison"]
        return self._compiled(names, constants, COMPARISON, ["compare"])["compare"]

    def surface(self) -> Program:
        """The surface from depth maps: ``build_surface``."""
        entry = "build_surface"
        return self._compiled(["geometry", "surface"], {}, SURFACE, [entry])[entry]

    def visibility(self) -> Program:
        """Which views see any of the virtual frustum: ``find_visible``."""
        names, entry = ["geometry", "surface_lookup", "visibility"], "find_visible"
        return self._compiled(names, {}, VISIBILITY, [entry])[entry]

    def _shading(self) -> list[str]:
        weights = "weights" if self.rule is Blending.UNSTRUCTURED else "mesh"
        return ["geometry", "surface_lookup", weights, "shading"]

    def _compiled(
        self,
        names: Sequence[str],
        constants: Mapping[str, Constant],
        bindings: Sequence[str],
        entries: Sequence[str],
    ) -> dict[str, Program]:
        """Entry points with the same bindings, compiled unless the GPU has them already."""
        device, programs = self.gpu.device, self.gpu.programs
        text = source(names, {"HAS_DEPTH": self.has_depth, **rule_constants(), **constants})
        if text in programs:
            return programs[text]
        with gpu_errors():
            module = device.create_shader_module(code=text)
            layout = device.create_bind_group_layout(
                entries=[
                    {"binding": number, "visibility": wgpu.ShaderStage.COMPUTE, **_binding(kind)}
                    for number, kind in enumerate(bindings)
                ]
            )
            pipeline_layout = device.create_pipeline_layout(bind_group_layouts=[layout])
            programs[text] = {
                entry: Program(
                    device.create_compute_pipeline(
                        layout=pipeline_layout, compute={"module": module, "entry_point": entry}
                    ),
                    layout,
                )
                for entry in entries
            }
        return programs[text]


def needs_two_passes(cost: Cost, fit_gain: bool) -> bool:
    """Whether a cost needs the whole image before it can be summed up."""
    return cost is Cost.GRADIENT or (cost is Cost.ROBUST and fit_gain)


def rule_constants() -> dict[str, Constant]:
    """Constants of the blending and of the surface."""
    return {
        "FRUSTUM_SAMPLES": reference.FRUSTUM_SAMPLES,
        "SMALLEST_WEIGHT": reference.SMALLEST_WEIGHT,
        "SMALLEST_RELATIVE_DEPTH": delaunay_mesh.SMALLEST_RELATIVE_DEPTH,
        "MOST_RANKED": blending.MOST_RANKED,
        "CANDIDATE_POINTS": blending.CANDIDATE_POINTS,
        "RESOLUTION_PENALTY": view_penalties.RESOLUTION_PENALTY,
        "BORDER_SHARE": view_penalties.BORDER_SHARE,
        "BORDER_PENALTY": view_penalties.BORDER_PENALTY,
        "SMALLEST_MARGIN": view_penalties.SMALLEST_MARGIN,
        "SMALLEST_PENALTY": blending.SMALLEST_PENALTY,
        "OCCLUSION_FACTOR": blending.OCCLUSION_FACTOR,
        "SOURCE_VIEWS": surface.SOURCE_VIEWS,
        "PIXEL_PARTS": surface.PIXEL_PARTS,
        "ROTATION_COST": surface.ROTATION_COST,
        "PINHOLE_FACTOR": surface.PINHOLE_FACTOR,
        "PINHOLE_NEIGHBOURS": surface.PINHOLE_NEIGHBOURS,
        "EDGE_FACTOR": surface.EDGE_FACTOR,
    }


def cost_constants() -> dict[str, Constant]:
    """Constants of the comparison."""
    return {
        "ROBUST_LIMIT": comparison.ROBUST_LIMIT,
        "GRADIENT_LIMIT": comparison.GRADIENT_LIMIT,
        "UNCOVERED_SQUARED": comparison.UNCOVERED_SQUARED,
        "UNCOVERED_ROBUST": comparison.UNCOVERED_ROBUST,
        "UNCOVERED_ZNCC": comparison.UNCOVERED_ZNCC,
        "UNCOVERED_GRADIENT": comparison.UNCOVERED_GRADIENT,
        "LARGEST_GAIN": comparison.LARGEST_GAIN,
        "EVIDENCE_BIN": comparison.EVIDENCE_BIN,
        "EVIDENCE_BINS": comparison.EVIDENCE_BINS,
    }


def source(names: Sequence[str], constants: Mapping[str, Constant]) -> str:
    """The text of a program: its constants, then its files."""
    folder = files("pipelines.render") / "gpu_shaders"
    texts = [(folder / f"{name}.wgsl").read_text(encoding="utf-8") for name in names]
    return "\n".join([*(_declared(name, value) for name, value in constants.items()), *texts])


def _declared(name: str, value: Constant) -> str:
    if isinstance(value, bool):
        return f"const {name}: bool = {str(value).lower()};"
    if isinstance(value, int):
        return f"const {name}: u32 = {value}u;"
    return f"const {name}: f32 = {value!r};"


def _binding(kind: str) -> dict[str, Any]:
    if kind in ("depths", "texels"):
        sample = "unfilterable-float" if kind == "depths" else "uint"
        return {"texture": {"sample_type": sample, "view_dimension": "2d-array"}}
    types = {"uniform": "uniform", "read": "read-only-storage", "write": "storage"}
    return {"buffer": {"type": types[kind]}}
