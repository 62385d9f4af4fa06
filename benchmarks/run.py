"""All measurements: ``make bench`` prints Markdown tables and writes ``results.json``."""

import json
import sys
from collections.abc import Callable
from typing import Any

import cv2

from benchmarks import (
    cold_start,
    comparison,
    depth,
    gpu,
    memory,
    opening,
    rendering,
    scoring,
    tracking,
)
from benchmarks.scenes import ROOT, elevators_scene, workshop_scene
from benchmarks.timing import machine, markdown_table
from benchmarks.torch_path import is_installed
from pipelines.artifacts.atomic import write_text
from pipelines.lightfield.scene import Scene

RESULTS = ROOT / "benchmarks" / "results.json"


def measurements(workshop: Scene, lobby: Scene) -> dict[str, Callable[[], dict[str, Any]]]:
    """All that is measured; each gives some keys of the results."""
    return {
        "comparison": lambda: comparison.measure(workshop),
        "particles": lambda: scoring.measure(lobby),
        "frames": lambda: tracking.measure(lobby),
        "rendering": lambda: rendering.measure(workshop),
        "opening": lambda: opening.measure(workshop),
        "depth maps": depth.measure,
        "cold start": lambda: cold_start.measure(lobby),
        "memory": lambda: memory.measure(workshop, lobby),
        "GPU": lambda: gpu.measure(workshop),
    }


def tables(results: dict[str, Any]) -> str:
    """The results for people: Markdown."""
    parts = [
        "Medians over repeats.",
        markdown_table(("machine", ""), list(results["machine"].items())),
        "Three photos, a plane, one thread, processor time. In brackets: how many times as fast as "
        f"OpenCV {cv2.__version__}, at its fastest; how many times the limit.",
        comparison.table(results["comparison"]["microseconds_per_particle"]),
    ]
    if not is_installed():
        parts.append("PyTorch is not installed, and not compared with.")
    parts += [
        "The lobby's 28 views, processor time and, in brackets, time by the clock on the wall.",
        scoring.tables(results),
        tracking.table(results),
        rendering.table(results["rendering"]),
        opening.table(results["opening"]),
        depth.table(results["depth"]),
        cold_start.table(results),
        memory.table(results["peak_memory_bytes"]),
        gpu.table(results["gpu"]),
    ]
    return "\n\n".join(parts)


def main() -> None:
    """Measures, prints, and writes ``results.json``."""
    cv2.setNumThreads(1)
    results: dict[str, Any] = {"machine": machine()}
    for name, measure in measurements(workshop_scene(), elevators_scene()).items():
        print(f"measuring: {name}", file=sys.stderr)
        results.update(measure())
    write_text(RESULTS, json.dumps(results, indent=2) + "\n", overwrite=True)
    print(tables(results))
    print(f"\nwritten to {RESULTS.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
