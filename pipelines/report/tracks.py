"""The paths that a report compares: estimate, odometry and, where known, ground truth."""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.geometry.pose import camera_heading_of
from pipelines.localize.evaluation import (
    RunEvaluation,
    TrackEvaluation,
    evaluate_run,
    odometry_states,
)
from pipelines.localize.run import PNP_ESTIMATE, Run


@dataclass(frozen=True)
class Tracks:
    """Where the body was at the frames, as seen from above (``seen_from_above``), each ``(N, 3)``.

    Attributes:
        estimate_name: which estimate of the run ``estimated`` is; "none" where it has none at all.
        estimated_states: ``(N, D)``; rows of NaN in frames without an estimate.
        odometry_states: ``(N, D)`` placed in the world; None where there was none or it has no
            place.
        estimated: the same as ``estimated_states``, from above.
        odometry: likewise.
        groundtruth: rows of NaN in frames without it; None where it is unknown altogether.
        evaluation: errors of the estimate and of odometry; None where they are unknown.
        pnp: poses by features, from above; rows of NaN in frames without; None where the run noted
            none beside the estimate.
    """

    estimate_name: str
    estimated_states: FloatArray
    odometry_states: FloatArray | None
    estimated: FloatArray
    odometry: FloatArray | None
    groundtruth: FloatArray | None
    evaluation: RunEvaluation | None
    pnp: FloatArray | None = None

    @property
    def estimate_errors(self) -> TrackEvaluation | None:
        """Errors of the estimate; None where they are unknown."""
        return None if self.evaluation is None else self.evaluation.errors

    @property
    def odometry_errors(self) -> TrackEvaluation | None:
        """Errors of odometry alone; None where they are unknown."""
        return None if self.evaluation is None else self.evaluation.odometry

    @property
    def pnp_errors(self) -> TrackEvaluation | None:
        """Errors of the poses by features beside the estimate; None where they are unknown."""
        if self.evaluation is None or self.evaluation.pnp is None or self.pnp is None:
            return None
        return self.evaluation.pnp.errors


def tracks_of(run: Run, estimate: str | None) -> Tracks:
    """The paths of a run.

    Args:
        run: may lack estimates in some frames or in all.
        estimate: name of one of the run's estimates; None for the run's own choice.

    Raises:
        OptionError: the run has no estimate of that name.
    """
    if estimate is None and not run.own_estimate_names:
        # Lost throughout: the report has to show just that.
        name, estimated = "none", np.full((len(run.frames), run.space.dimension), np.nan)
    else:
        name = run.default_estimate if estimate is None else estimate
        estimated = run.estimated_states(estimate)
    truth = run.groundtruth
    if truth is not None and not known_rows(truth).any():
        truth = None
    # Odometry has no place of its own: it is put where the truth or the first estimate is.
    has_place = truth is not None or bool(run.own_estimate_names)
    comparable = truth is not None and bool(np.any(known_rows(truth) & known_rows(estimated)))
    has_pnp = name != PNP_ESTIMATE and PNP_ESTIMATE in run.estimate_names
    odometry = odometry_states(run) if run.odometry is not None and has_place else None
    return Tracks(
        estimate_name=name,
        estimated_states=estimated,
        odometry_states=odometry,
        estimated=seen_from_above(run, estimated),
        odometry=None if odometry is None else seen_from_above(run, odometry),
        groundtruth=None if truth is None else seen_from_above(run, truth),
        evaluation=evaluate_run(run, estimate=estimate) if comparable else None,
        pnp=seen_from_above(run, run.estimated_states(PNP_ESTIMATE)) if has_pnp else None,
    )


def seen_from_above(run: Run, states: FloatArray) -> FloatArray:
    """What a top view shows of states ``(N, D)``: ``(N, 3)`` x, y (metres) and heading (radians).

    A body with six degrees of freedom has no heading of its own; where its camera looks, seen from
    above, stands for it. Rows of NaN stay such.
    """
    if run.space.dimension == 3:
        return states
    above = np.full((len(states), 3), np.nan)
    known = known_rows(states)
    above[known, :2] = states[known, :2]
    above[known, 2] = camera_heading_of(run.space.poses(states[known]) @ run.base_from_camera)
    return above


def known_rows(states: FloatArray) -> BoolArray:
    """Which of the states ``(N, D)`` are known; ``(N,)``."""
    return np.asarray(np.all(np.isfinite(states), axis=1), dtype=np.bool_)
