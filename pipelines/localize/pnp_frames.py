"""What perspective-n-point says of a frame, in the terms of a run file."""

from dataclasses import replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.belief import Belief, Region, uniform_belief
from pipelines.localize.pnp import PnpAnswer
from pipelines.localize.run import PNP_ESTIMATE, FrameRecord
from pipelines.localize.settings import LocalizerSettings

# Places of features err together where the map does: reprojection errors' standard deviations times
# this cover the truth as often as they should.
MODEL_ERROR = 3.3


def pnp_record(
    answer: PnpAnswer,
    region: Region,
    settings: LocalizerSettings,
    rng: np.random.Generator,
    timestamp: float,
    image_name: str,
) -> FrameRecord:
    """The record of a frame that nothing but its features located.

    With a pose the belief is that one pose. Without, the frame is "lost" and has no estimate; the
    belief is then what is known: the body is anywhere in the region.

    Args:
        answer: what the features say.
        region: where the body may be.
        settings: how many states stand for "anywhere", and how accurate the map is.
        rng: draws them.
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
        # Landmarks are not quite where they are thought to be, and many err alike.
        covariance = MODEL_ERROR**2 * answer.covariance + _map_covariance(settings)
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
    """A frame of the filter with the time that the features took and, where noted, their pose."""
    estimates = dict(record.estimates)
    if noted and answer.state is not None:
        estimates[PNP_ESTIMATE] = answer.state
    seconds = {**record.seconds, PNP_ESTIMATE: answer.seconds}
    return replace(record, estimates=estimates, seconds=seconds)


def _map_covariance(settings: LocalizerSettings) -> FloatArray:
    space = settings.state_space
    sigmas = [settings.map_position_sigma] * space.positions
    return np.diag(np.square(sigmas + [settings.map_heading_sigma] * space.angles))
