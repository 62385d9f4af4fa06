"""Prints a Markdown table from the JSON files that ``lfnav evaluate --json`` writes.

Usage: summarize.py out/experiments/SET/VARIANT/seed-N.json ...
"""

import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

HEADINGS = (
    "data set",
    "variant",
    "success",
    "position, last 5 (m)",
    "heading, last 5 (deg)",
    "odometry, last 5 (m)",
    "s a frame",
)


def main(arguments: Sequence[str]) -> int:
    """Reads the evaluations named on the command line and prints the table."""
    evaluations: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for argument in arguments:
        path = Path(argument)
        key = (path.parent.parent.name, path.parent.name)
        evaluations.setdefault(key, []).append(json.loads(path.read_text(encoding="utf-8")))
    print(f"| {' | '.join(HEADINGS)} |")
    print(f"|{'---|' * len(HEADINGS)}")
    for (data_set, variant), group in evaluations.items():
        print(f"| {' | '.join((data_set, variant, *row(group)))} |")
    print("\nErrors and times are medians over the runs of the mean over the last five frames.")
    return 0


def row(group: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """The cells for the runs of one variant: success, errors, odometry's error, time."""
    successes = sum(bool(evaluation["success"]) for evaluation in group)
    return (
        f"{successes} of {len(group)}",
        f"{median(group, 'position_error_m', 'last5_mean'):.3f}",
        f"{median(group, 'heading_error_deg', 'last5_mean'):.2f}",
        f"{median(group, 'odometry', 'position_error_m', 'last5_mean'):.3f}",
        f"{median(group, 'seconds_per_frame'):.2f}",
    )


def median(group: Sequence[Mapping[str, Any]], *keys: str) -> float:
    """Median over the runs of the number that ``keys`` lead to; NaN where no run has it."""
    values = []
    for evaluation in group:
        value: Any = evaluation
        for key in keys:
            value = value.get(key) if isinstance(value, Mapping) else None
        if value is not None:
            values.append(float(value))
    return statistics.median(values) if values else float("nan")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
