"""What a frame's record says, as JSON: the pose first, and how far it is to be trusted.

Numbers are those of the record, to the last digit: JSON holds the shortest decimal that is read
back as the same number.
"""

from typing import Any

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.run import ESTIMATE_PREFERENCE, FrameRecord
from pipelines.localize.state_space import StateSpace
from pipelines.localize.trajectory_export import STATE_NAMES


def answer_of(
    record: FrameRecord, space: StateSpace, areas: tuple[str, ...], notes: tuple[str, ...]
) -> dict[str, Any]:
    """An image's answer, in plain JSON types.

    Args:
        record: of the image.
        space: what a state is.
        areas: names of the world's areas; none in a scene.
        notes: what the user should know of the images so far.
    """
    names = STATE_NAMES[space.name]
    known = [name for name in ESTIMATE_PREFERENCE if name in record.estimates]
    pose = covariance = None
    if known:
        pose = state_as_json(record.estimates[known[0]], names)
        refined = record.refined_covariance if known[0] == "refined" else None
        covariance = (record.covariance if refined is None else refined).tolist()
    belief = record.area_belief
    return {
        "status": record.status,
        "confidence": float(record.confidence),
        "pose": pose,
        "estimate": known[0] if known else None,
        "covariance": covariance,
        "modes": [
            {**state_as_json(mode[:-1], names), "share": float(mode[-1])} for mode in record.modes
        ],
        "estimates": {
            name: state_as_json(state, names) for name, state in record.estimates.items()
        },
        "effective_sample_size": float(record.effective_sample_size),
        "areas": None
        if belief is None
        else {name: float(share) for name, share in zip(areas, belief, strict=True)},
        "notes": list(notes),
        "seconds": {name: float(seconds) for name, seconds in record.seconds.items()},
    }


def state_as_json(state: FloatArray, names: tuple[str, ...]) -> dict[str, float]:
    """A state ``(D,)`` with the names of its numbers, which say their units."""
    return {name: float(value) for name, value in zip(names, state, strict=True)}
