"""All measurements: ``make bench`` prints Markdown tables and writes ``results.json``."""

import json

import cv2

from benchmarks import comparison, depth, gpu, memory, opening, rendering
from benchmarks.scenes import ROOT, workshop_scene
from benchmarks.timing import machine
from pipelines.artifacts.atomic import write_text

RESULTS = ROOT / "benchmarks" / "results.json"


def main() -> None:
    """Measures, prints, and writes ``results.json``."""
    cv2.setNumThreads(1)
    scene = workshop_scene()
    results = {
        **comparison.measure(scene),
        **rendering.measure(scene),
        **opening.measure(scene),
        **depth.measure(),
        **memory.measure(),
        **gpu.measure(scene),
        "machine": machine(),
    }
    write_text(RESULTS, json.dumps(results, indent=2) + "\n", overwrite=True)
    print("Medians over repeats. In brackets: how many times as fast as the same work with")
    print(f"OpenCV {cv2.__version__}, on one thread.\n")
    print(comparison.table(results["microseconds_per_particle"]), end="\n\n")
    print(rendering.table(results["rendering"]), end="\n\n")
    print(opening.table(results["opening"]), end="\n\n")
    print(depth.table(results["depth"]), end="\n\n")
    print(memory.table(results["peak_memory_bytes"]), end="\n\n")
    print(gpu.table(results["gpu"]))
    print(f"\nwritten to {RESULTS.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
