"""Summary of a scene model, for people and programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipelines.geometry.camera import cameras_text
from pipelines.geometry.pose import camera_heading_of
from pipelines.lightfield.scene import PlaneEstimate, Scene
from pipelines.lightfield.scene_file import load_scene, scene_provenance
from pipelines.lightfield.size_budget import SizeBudget, size_budget

# Where the provenance of a scene names the photos that it was made without.
LEFT_OUT = "left_out"


@dataclass(frozen=True)
class SceneSummary:
    """A scene model and the file that holds it.

    Attributes:
        path: the file.
        scene: its content.
        left_out: photos that the reconstruction has and the scene does not hold, since others show
            nearly the same.
        budget: what it takes on disk and in memory.
    """

    path: Path
    scene: Scene
    left_out: tuple[str, ...]
    budget: SizeBudget

    def table(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        facts = self.to_dict()
        plane, bounds, unit = facts["plane"], facts["bounds_m"], self.scene.unit
        return [
            ("scene", str(self.path)),
            ("views", _views_text(facts)),
            ("cameras", cameras_text(self.scene.cameras)),
            ("depth maps", _depth_text(facts["depth"], unit)),
            ("storage", _storage_text(facts)),
            *_plane_rows(plane, unit),
            ("area", "x {:.2f} to {:.2f} {u}, y {:.2f} to {:.2f} {u}".format(*bounds, u=unit)),
            *_ground_rows(facts["free_ground_m2"], unit),
            ("viewing directions", "{:.0f} to {:.0f} deg".format(*facts["headings_deg"])),
            ("scale from", facts["scale_source"]),
            ("robot mount", "yes" if facts["has_mount"] else "no"),
            *self.budget.table(),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        scene = self.scene
        headings = np.degrees(np.unwrap(camera_heading_of(scene.world_from_camera)))
        return {
            "path": str(self.path),
            "kind": "scene",
            "views": len(scene),
            "left_out": list(self.left_out),
            "image_megabytes": sum(map(len, scene.encoded_images)) / 1e6,
            "storage": _storage_facts(scene),
            "cameras": [f"{c.model} {c.width}x{c.height}" for c in scene.cameras],
            "plane": None if scene.surface is None else _plane_facts(scene.surface),
            "depth": _depth_facts(scene),
            "bounds_m": scene.bounds.tolist(),
            "free_ground_m2": None if scene.ground is None else scene.ground.area,
            "headings_deg": [float(headings.min()), float(headings.max())],
            "scale_source": scene.scale_source,
            "has_mount": scene.base_from_camera is not None,
            "identifier": scene.identifier,
            "size": self.budget.to_dict(),
        }


def describe_scene(path: Path) -> SceneSummary:
    """Reads a scene model and summarizes it.

    Raises:
        InputError: missing, not a scene, damaged, or of a newer schema.
    """
    return summary_of(path, load_scene(path))


def summary_of(path: Path, scene: Scene) -> SceneSummary:
    """Summarizes a scene whose file has been read already.

    Raises:
        InputError: the file cannot be read.
    """
    left_out = scene_provenance(path).get(LEFT_OUT, [])
    names = tuple(str(name) for name in left_out) if isinstance(left_out, list) else ()
    return SceneSummary(path, scene, names, size_budget(path, scene))


def _views_text(facts: dict[str, Any]) -> str:
    kind = "as recorded" if facts["storage"]["kind"] == "full" else "compact"
    text = f"{facts['views']} ({facts['image_megabytes']:.1f} MB {kind})"
    if not facts["left_out"]:
        return text
    total = facts["views"] + len(facts["left_out"])
    return f"{text}, chosen from {total}; {len(facts['left_out'])} left out"


def _plane_facts(surface: PlaneEstimate) -> dict[str, Any]:
    return {
        "coefficients": surface.plane.coefficients().tolist(),
        "method": surface.method,
        "quality": surface.quality,
        "offset_sigma_m": _finite(surface.offset_sigma),
        "angle_sigma_deg": _finite(float(np.degrees(surface.angle_sigma))),
    }


def _plane_rows(plane: dict[str, Any] | None, unit: str) -> list[tuple[str, str]]:
    if plane is None:
        return [("plane", "none: depth maps alone show the surface")]
    equation = "{:.4f} x + {:.4f} y + {:.4f} z + {:.4f} = 0".format(*plane["coefficients"])
    return [("plane", equation), ("plane from", _origin(plane, unit))]


def _ground_rows(area: float | None, unit: str) -> list[tuple[str, str]]:
    return [] if area is None else [("free ground", f"{area:.1f} {unit}\u00b2 of it")]


def _storage_facts(scene: Scene) -> dict[str, Any]:
    """Full or compact storage, bytes of a view's photo, and what compact storage lost."""
    stored = sum(map(len, scene.encoded_images))
    facts: dict[str, Any] = {"kind": "full", "photo_bytes_per_view": stored / len(scene)}
    if scene.compaction is None:
        return facts
    recorded = scene.compaction.recorded_bytes
    return {
        **facts,
        "kind": "compact",
        "recorded_photo_bytes_per_view": recorded / len(scene),
        "photo_psnr_db": scene.compaction.photo_psnr,
        "depth_error": scene.compaction.depth_error,
    }


def _storage_text(facts: dict[str, Any]) -> str:
    storage = facts["storage"]
    if storage["kind"] == "full":
        return "full: photos as recorded"
    stored, recorded = storage["photo_bytes_per_view"], storage["recorded_photo_bytes_per_view"]
    text = (
        f"compact: {stored / 1e3:.1f} kB a photo (as recorded {recorded / 1e3:.1f} kB), "
        f"{storage['photo_psnr_db']:.1f} dB against the recorded ones of this size"
    )
    if storage["depth_error"] is None:
        return text
    return f"{text}; depth to {storage['depth_error']:.2%}"


def _depth_facts(scene: Scene) -> dict[str, Any] | None:
    """Size, confident share and median of the depth maps; None where there are none."""
    if not scene.depth:
        return None
    known = np.concatenate([d.inverse_depth[d.inverse_depth > 0.0] for d in scene.depth])
    height, width = scene.depth[0].inverse_depth.shape
    return {
        "width": width,
        "height": height,
        "known_share": known.size / sum(d.inverse_depth.size for d in scene.depth),
        "confident_share": float(np.mean([d.confident.mean() for d in scene.depth])),
        "median_m": float(1.0 / np.median(known)),
    }


def _depth_text(facts: dict[str, Any] | None, unit: str) -> str:
    if facts is None:
        return "none"
    return (
        f"{facts['width']}x{facts['height']}, {facts['known_share']:.0%} of the pixels known, "
        f"{facts['confident_share']:.0%} confident, median {facts['median_m']:.2f} {unit}"
    )


def _origin(plane: dict[str, Any], unit: str) -> str:
    if plane["method"] == "given":
        return "given"
    if plane["offset_sigma_m"] is None or plane["angle_sigma_deg"] is None:
        certainty = "uncertainty unknown"
    else:
        sigma = plane["offset_sigma_m"]
        offset = f"{sigma * 100:.1f} cm" if unit == "m" else f"{sigma:.2g} {unit}"
        certainty = f"+-{offset}, {plane['angle_sigma_deg']:.2f} deg"
    if plane["method"] == "points":
        return f"sparse points ({plane['quality']:.0%} of them on it, {certainty})"
    return f"the photos (correlation {plane['quality']:.2f}, {certainty})"


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
