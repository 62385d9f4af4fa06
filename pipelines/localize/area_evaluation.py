"""How well a run in a world knew in which area the body was, and how it crossed borders.

The true area is that of the nearest photo that is at home in an area (``lightfield.area_map``); on
the border between two, either.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.run import Run
from pipelines.localize.state_space import known_states

# So many frames are a matter of searching.
FIRST_FRAMES = 3
# A border is crossed over so many frames before and after it.
AROUND_BORDER = 3
# Metres by which the nearest photo of another area may be farther where a place is on their border.
BORDER_WIDTH = 0.1


@dataclass(frozen=True)
class AreaEvaluation:
    """The belief over areas compared with the truth.

    Attributes:
        right_share: share of the frames with a truth in which the true area is the likeliest, more
            probable than any other and than none of them.
        right_share_later: the same of the frames after the third; NaN where there are none.
        mean_probability: of the true area, over the frames with a truth.
        borders: how often the truth went from one area to another.
        lost_at_borders: frames around these without an estimate, or that are not tracked.
        largest_jump: metres, the most that an estimate moved otherwise than the truth between two
            frames around a border; None where there is none.
    """

    right_share: float
    right_share_later: float
    mean_probability: float
    borders: int
    lost_at_borders: int
    largest_jump: float | None

    def rows(self) -> list[tuple[str, ...]]:
        """Rows for people."""
        rows: list[tuple[str, ...]] = [
            ("frames in the right area", f"{self.right_share:.1%}"),
            (f"the same after frame {FIRST_FRAMES}", f"{self.right_share_later:.1%}"),
            ("mean probability of the right area", f"{self.mean_probability:.3f}"),
            ("borders crossed", str(self.borders)),
        ]
        if self.largest_jump is not None:
            rows.append(("frames not tracked at borders", str(self.lost_at_borders)))
            rows.append(("largest jump at a border (m)", f"{self.largest_jump:.3f}"))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        later = self.right_share_later
        return {
            "right_share": self.right_share,
            "right_share_later": later if np.isfinite(later) else None,
            "mean_probability": self.mean_probability,
            "borders": self.borders,
            "lost_at_borders": self.lost_at_borders,
            "largest_jump_m": self.largest_jump,
        }


def evaluate_areas(run: Run, truth: FloatArray, estimated: FloatArray) -> AreaEvaluation | None:
    """Compares a run's belief over areas with the truth.

    Args:
        run: the run.
        truth: ``(N, D)`` true states, NaN where unknown; at least one is known.
        estimated: ``(N, D)`` estimates, NaN where there is none.

    Returns:
        None where the run was made with one scene.
    """
    if run.areas is None:
        return None
    known = known_states(truth)
    belief = np.stack([f.area_belief for f in run.frames if f.area_belief is not None])
    areas = np.full(len(truth), -1, dtype=np.int64)
    areas[known] = run.areas.areas_of(truth[known, :2])
    # On a border itself it is both: an estimate may be on its other side by a millimetre.
    is_true = np.zeros(belief.shape, dtype=np.bool_)
    is_true[known] = run.areas.borders(truth[known, :2], BORDER_WIDTH)
    probability = np.where(is_true, belief, 0.0).sum(axis=1)
    none = 1.0 - belief.sum(axis=1)
    right = is_true[np.arange(len(truth)), np.argmax(belief, axis=1)] & (probability > none)
    later = known & (np.arange(len(truth)) >= FIRST_FRAMES)
    is_border = known[1:] & known[:-1] & (areas[1:] != areas[:-1])
    errors = estimated[:, :2] - truth[:, :2]
    jumps = np.linalg.norm(np.diff(errors, axis=0), axis=1)
    around = np.zeros(len(jumps), dtype=np.bool_)
    for border in np.flatnonzero(is_border):
        around[max(0, border - AROUND_BORDER) : border + AROUND_BORDER + 1] = True
    frames = np.flatnonzero(around) + 1
    tracked = np.array([frame.status == "tracking" for frame in run.frames])
    seen = jumps[around & np.isfinite(jumps)]
    return AreaEvaluation(
        right_share=float(np.mean(right[known])),
        right_share_later=float(np.mean(right[later])) if later.any() else float("nan"),
        mean_probability=float(np.mean(probability[known])),
        borders=int(np.count_nonzero(is_border)),
        lost_at_borders=int(np.count_nonzero(~(tracked & known_states(estimated))[frames])),
        largest_jump=float(seen.max()) if len(seen) else None,
    )
