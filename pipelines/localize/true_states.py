"""The true states of frames: interpolated ground truth, NaN where none is known."""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError
from pipelines.dataset.dataset import Dataset
from pipelines.geometry.interpolation import PAIRING_TOLERANCE, poses_at_times
from pipelines.geometry.time_units import hint_on_times
from pipelines.geometry.trajectory import Trajectory
from pipelines.localize.run import Run
from pipelines.localize.state_space import StateSpace, known_states


def states_of_truth(dataset: Dataset, space: StateSpace, max_gap: float) -> FloatArray | None:
    """True states at the images of a data set; for evaluation only.

    Args:
        dataset: with ground truth, or without.
        space: which states.
        max_gap: seconds between two true poses around an image at most.

    Returns:
        ``(N, D)``, NaN where none is known; None where the data set has no ground truth.
    """
    if dataset.groundtruth is None:
        return None
    found = poses_at_times(dataset.groundtruth, dataset.timestamps, max_gap)
    states = np.full((len(dataset), space.dimension), np.nan)
    states[found.is_known] = space.states(found.poses[found.is_known])
    return states


def true_states(
    run: Run,
    groundtruth: Trajectory | None,
    run_path: Path | str,
    groundtruth_path: Path | str | None,
    max_gap: float,
) -> FloatArray:
    """True states of a run's frames.

    Args:
        run: the run.
        groundtruth: world_from_base; None: those that the run carries.
        run_path: how errors name the run.
        groundtruth_path: how errors name the ground truth; None: so.
        max_gap: seconds between two true poses around a frame at most.

    Returns:
        ``(N, D)``, NaN where there is none; at least one is known.

    Raises:
        InputError: there is no ground truth, or none at any frame.
    """
    if groundtruth is None:
        if run.groundtruth is None or not np.any(known_states(run.groundtruth)):
            raise InputError(
                run_path, "carries no ground truth", "give a TUM file with --groundtruth"
            )
        return run.groundtruth
    found = poses_at_times(groundtruth, run.timestamps, max_gap)
    if not np.any(found.is_known):
        raise InputError(
            groundtruth_path or "ground truth",
            f"no pose lies within {PAIRING_TOLERANCE:g} s of a frame of {run_path}",
            hint_on_times(run.timestamps, groundtruth.timestamps),
        )
    states = np.full((len(run.frames), run.space.dimension), np.nan)
    states[found.is_known] = run.space.states(found.poses[found.is_known])
    return states
