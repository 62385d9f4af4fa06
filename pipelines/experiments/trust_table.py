"""The table of the study of trust: one line a condition, and their sums; Markdown and JSON."""

import json
import math
from collections.abc import Sequence
from typing import Any

from pipelines.experiments.sweep_tables import markdown_table, number_text
from pipelines.experiments.trust_study import Row
from pipelines.localize.trust import Trust, pooled

HEADINGS = (
    "condition",
    "odometry",
    "method",
    "success",
    "right (%)",
    "silent (%)",
    "wrong (%)",
    "wrong at the end",
    "median error of right",
    "in 95 % region",
    "ECE",
    "sure",
    "sure, not close",
    "sure, wrong",
)
EXPLANATION = (
    "A run succeeds when its errors, averaged over the last five frames, are below 0.15 m and 3 "
    "degrees. Right: frames with status tracking within 0.3 m and 10 degrees of the truth; wrong: "
    "other frames with this status, all of them where the images show another place; silent: the "
    "rest. Wrong at the end: runs with a wrong frame among their last ten. In 95 % region: frames "
    "with status tracking whose truth lies where the stated covariance says. ECE: expected "
    "calibration error, ten bins, of the confidence as the probability of being close: within 0.1 "
    "m and 3 degrees. Sure: frames with a confidence of 0.9 or more; of them those that are not "
    "close, and those that are wrong. The sums leave out single frames with a given start."
)
IN_THE_MAP, ELSEWHERE, ALL = "all, in the map", "all, elsewhere", "all"


def sums_of(rows: Sequence[Row]) -> tuple[Row, ...]:
    """The sums of all rows of a method: those in the map, those elsewhere, and all.

    Rows of single frames are left out, since their start is given. Runs with other degrees of
    freedom have sums of their own.
    """
    drives = [row for row in rows if not row.is_of_single_frames]
    keys = dict.fromkeys((row.method, row.trust.degrees_of_freedom) for row in drives)
    found = []
    for method, freedom in keys:
        own = [
            row for row in drives if (row.method, row.trust.degrees_of_freedom) == (method, freedom)
        ]
        suffix = "" if freedom == 3 else f", {freedom} degrees of freedom"
        for name, is_elsewhere in ((IN_THE_MAP, False), (ELSEWHERE, True), (ALL, None)):
            chosen = [row for row in own if is_elsewhere in (None, row.is_elsewhere)]
            # A sum of all that repeats one of the other two is left out.
            if chosen and not (is_elsewhere is None and len({r.is_elsewhere for r in own}) == 1):
                found.append(_sum(name + suffix, method, chosen))
    return tuple(found)


def as_markdown(rows: Sequence[Row], skipped: Sequence[str]) -> str:
    """The table, with an explanation and what was skipped."""
    cells = [_cells(row) for row in (*rows, *sums_of(rows))]
    text = [*markdown_table([HEADINGS, *cells], texts=3), "", EXPLANATION]
    if skipped:
        text += ["", f"Skipped, since their data are absent: {', '.join(skipped)}."]
    return "\n".join(text) + "\n"


def as_json(rows: Sequence[Row], skipped: Sequence[str]) -> str:
    """The table as JSON, with the data of the reliability diagrams."""
    content = {
        "conditions": [_values(row) for row in rows],
        "sums": [_values(row) for row in sums_of(rows)],
        "skipped": list(skipped),
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _sum(name: str, method: str, rows: Sequence[Row]) -> Row:
    """The sum of several rows."""
    successes = [row.successes for row in rows if row.successes is not None]
    is_elsewhere = all(row.is_elsewhere for row in rows)
    # Where some runs cannot succeed, a number of successes would be misleading.
    total = sum(successes) if len(successes) == len(rows) else None
    return Row(name, "-", method, is_elsewhere, total, pooled([row.trust for row in rows]))


def _values(row: Row) -> dict[str, Any]:
    """A row as plain JSON types."""
    return {
        "condition": row.name,
        "odometry": row.odometry,
        "method": row.method,
        "elsewhere": row.is_elsewhere,
        "successes": row.successes,
        **row.trust.to_dict(),
    }


def _cells(row: Row) -> tuple[str, ...]:
    """A row of the Markdown table."""
    trust = row.trust
    shares = (trust.share(kind) for kind in (trust.right, trust.silent, trust.wrong))
    return (
        row.name,
        row.odometry,
        row.method,
        "-" if row.successes is None else f"{row.successes} of {trust.runs}",
        *(number_text(100.0 * share, 1) for share in shares),
        f"{trust.runs_wrong_at_the_end} of {trust.runs}",
        _errors(trust),
        _percent(trust.in_region),
        number_text(trust.calibration_error, 3),
        _percent(trust.share(trust.sure)),
        _percent(trust.sure_not_close),
        _percent(trust.sure_wrong),
    )


def _errors(trust: Trust) -> str:
    position, heading = trust.median_errors_of_right
    return "-" if math.isnan(position) else f"{100.0 * position:.1f} cm, {heading:.2f}°"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100.0 * share:.1f} %"
