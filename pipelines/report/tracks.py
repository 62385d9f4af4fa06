"""The paths that a report compares: estimate, odometry and, where known, ground truth."""

from dataclasses import dataclass

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import camera_heading_of
from pipelines.localize.evaluation import (
    RunEvaluation,
    TrackEvaluation,
    evaluate_run,
    odometry_states,
)
from pipelines.localize.run import PNP_ESTIMATE, Run
from pipelines.localize.state_space import known_states


@dataclass(frozen=True)
class Tracks:
    """Paths of the body over ``N`` frames: its states, and their view from above.

    Attributes:
        estimate_name: name of the run's estimate that is shown; "none" where the run has none.
        estimated_states: ``(N, D)`` estimated states; NaN in frames without an estimate.
        odometry_states: ``(N, D)`` states by odometry in the world; None without odometry, or
            without a pose at which its path could start.
        estimated: ``(N, 3)`` ``estimated_states`` from above: x, y and heading.
        odometry: ``(N, 3)`` ``odometry_states`` from above; None where these are.
        groundtruth: ``(N, 3)`` true states from above; NaN in frames without ground truth; None
            without any.
        evaluation: errors of the estimate and of odometry; None where they are unknown.
        pnp: ``(N, 3)`` poses by features, from above; NaN in frames without one; None where the run
            has none beside the estimate.
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
        run: the run; frames may lack estimates.
        estimate: name of one of the run's estimates; None: the run's default.

    Raises:
        OptionError: the run has no estimate of that name.
    """
    if estimate is None and not run.own_estimate_names:
        # Lost in all frames; the report has to show that.
        name, estimated = "none", np.full((len(run.frames), run.space.dimension), np.nan)
    else:
        name = run.default_estimate if estimate is None else estimate
        estimated = run.estimated_states(estimate)
    truth = run.groundtruth
    if truth is not None and not known_states(truth).any():
        truth = None
    # Odometry has no origin in the world: its path starts at the true or the first estimated pose.
    has_place = truth is not None or bool(run.own_estimate_names)
    comparable = truth is not None and bool(np.any(known_states(truth) & known_states(estimated)))
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
    """States from above, ``(N, 3)``: x, y (metres) and heading (radians).

    The heading of a body with six degrees of freedom is that of its camera.

    Args:
        run: the run, which has the camera's mount.
        states: ``(N, D)``; rows of NaN stay NaN.
    """
    if run.space.dimension == 3:
        return states
    above = np.full((len(states), 3), np.nan)
    known = known_states(states)
    above[known, :2] = states[known, :2]
    above[known, 2] = camera_heading_of(run.space.poses(states[known]) @ run.base_from_camera)
    return above
