"""How far states are from true ones, frame by frame; unknown is NaN."""

import numpy as np

from pipelines.artifacts.array_types import BoolArray, FloatArray
from pipelines.localize.state_space import StateSpace


def state_errors(
    space: StateSpace, states: FloatArray, truth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distances ``(N,)`` in metres and angles ``(N,)`` in radians between states and the truth.

    NaN where either is unknown.
    """
    distances, angles = np.full((2, len(states)), np.nan)
    known = known_states(states) & known_states(truth)
    if np.any(known):
        offsets = space.difference(states[known], truth[known])
        distances[known] = np.linalg.norm(offsets[:, : space.positions], axis=1)
        angles[known] = np.linalg.norm(offsets[:, space.positions :], axis=1)
    return distances, angles


def known_states(states: FloatArray) -> BoolArray:
    """Which of the states ``(N, D)`` are known: finite in all numbers, ``(N,)``."""
    return np.asarray(np.all(np.isfinite(states), axis=1), dtype=np.bool_)
