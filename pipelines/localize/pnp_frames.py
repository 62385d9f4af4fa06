"""Poses by features as frames of a run."""

from dataclasses import replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief, Region, uniform_belief
from pipelines.localize.pnp import PnpAnswer
from pipelines.localize.run import PNP_ESTIMATE, FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import sigmas_of

# Landmarks err together where the map does: standard deviations by reprojection errors, times this,
# cover the truth as often as they should.
MODEL_ERROR = 3.3


def pnp_record(
    answer: PnpAnswer,
    region: Region,
    settings: LocalizerSettings,
    rng: np.random.Generator,
    timestamp: float,
    image_name: str,
) -> FrameRecord:
    """The record of a frame that is localized by its features alone.

    With a pose the belief is that one pose. Without, the frame is "lost" and has no estimate; the
    belief is then uniform over the region.

    Args:
        answer: the pose by features.
        region: where the body may be.
        settings: number of particles of a uniform belief, and accuracy of the map.
        rng: draws these particles.
        timestamp: seconds.
        image_name: as in the data set.
    """
    space = settings.state_space
    dimension = space.dimension
    if answer.state is None or answer.covariance is None:
        belief = uniform_belief(space, region, settings.particles, rng)
        estimates: dict[str, FloatArray] = {}
        modes = np.empty((0, dimension + 1))
        covariance = np.diag(np.square(space.spread(belief.states)))
    else:
        belief = Belief(answer.state[None], np.zeros(1))
        estimates = {PNP_ESTIMATE: answer.state}
        modes = np.append(answer.state, 1.0)[None]
        map_sigmas = sigmas_of(space, settings.map_position_sigma, settings.map_heading_sigma)
        covariance = MODEL_ERROR**2 * answer.covariance + np.diag(np.square(map_sigmas))
    return FrameRecord(
        timestamp=timestamp,
        image_name=image_name,
        particles=belief.states,
        log_weights=belief.log_weights,
        estimates=estimates,
        modes=modes,
        covariance=covariance,
        effective_sample_size=float(len(belief)),
        confidence=answer.confidence,
        status="tracking" if estimates else "lost",
        seconds={PNP_ESTIMATE: answer.seconds},
    )


def beside(record: FrameRecord, answer: PnpAnswer, *, noted: bool) -> FrameRecord:
    """A frame of the filter with the time that the pose by features took.

    Args:
        record: what the filter made of the frame.
        answer: the pose by features.
        noted: whether the pose becomes one of the frame's estimates.
    """
    estimates = dict(record.estimates)
    if noted and answer.state is not None:
        estimates[PNP_ESTIMATE] = answer.state
    seconds = {**record.seconds, PNP_ESTIMATE: answer.seconds}
    return replace(record, estimates=estimates, seconds=seconds)
