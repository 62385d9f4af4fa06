"""Evidence decides what of an alignment is taken over, and where it begins."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.localize.alignment import Alignment, Prior
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation, Observations
from pipelines.localize.settings import MotionModel
from tests.report_samples import CAMERA, MOUNT, photo
from tests.sequence_samples import (
    SCENE,
    START,
    TRUTH,
    increments,
    mixture_settings,
    position_error,
)


class Misled(MeasurementModel):
    """Alignments end elsewhere, and are as sure as ever."""

    def end(self, start: FloatArray, found: FloatArray, prior: Prior | None) -> FloatArray:
        """Where one ends that began at ``start`` and ought to end at ``found``."""
        raise NotImplementedError

    def aligned(
        self,
        state: FloatArray,
        observations: Observations,
        widths: Sequence[int],
        prior: Prior | None = None,
    ) -> Alignment:
        found = super().aligned(state, observations, widths, prior)
        return replace(found, state=self.end(state, found.state, prior))


class Aside(Misled):
    """By the image alone they end aside."""

    aside = np.zeros(3)

    def end(self, start: FloatArray, found: FloatArray, prior: Prior | None) -> FloatArray:
        return found if prior else found + self.aside


class Shortsighted(Misled):
    """Those that begin too far from the truth end where they began, as in another minimum."""

    truth = np.zeros(3)

    def end(self, start: FloatArray, found: FloatArray, prior: Prior | None) -> FloatArray:
        return found if float(np.hypot(*(start - self.truth)[:2])) < 0.15 else start


def test_an_alignment_that_loses_evidence_moves_nothing() -> None:
    # 3 cm aside is well within the gate after a motion that may be that wrong.
    chosen = mixture_settings(motion=MotionModel(position_floor=0.05))
    model = Aside.of_scene(SCENE, MOUNT, chosen)
    assert isinstance(model, Aside)
    robot = Localizer(SCENE, CAMERA, MOUNT, chosen, np.random.default_rng(0), model)
    motions = increments(TRUTH)
    for number, (state, motion) in enumerate(zip(TRUTH[:6], motions, strict=False)):
        model.aside = np.array([0.03, 0.0, 0.0]) if number >= 4 else np.zeros(3)
        record = robot.step(photo(state), motion, float(number))
    assert record.status == "tracking"
    assert position_error(record, state, "refined") < 0.01


def test_wheels_that_mislead_do_not_choose_where_an_alignment_begins() -> None:
    chosen = mixture_settings(motion=MotionModel(position_floor=0.1, heading_floor=0.06))
    for seed in range(4):
        model = Shortsighted.of_scene(SCENE, MOUNT, chosen)
        assert isinstance(model, Shortsighted)
        robot = Localizer(SCENE, CAMERA, MOUNT, chosen, np.random.default_rng(seed), model)
        for number, (state, motion) in enumerate(zip(TRUTH[:6], increments(TRUTH), strict=False)):
            model.truth = state
            wrong = np.array([0.15, 0.1, 0.08]) if number == 5 else np.zeros(3)
            record = robot.step(photo(state), motion + wrong, float(number))
        assert record.status == "tracking"
        assert position_error(record, state, "refined") < 0.02


class NeverExplained(Aside):
    """While ``is_contradicted``, no image speaks for any state."""

    is_contradicted = False

    def evidence_at(self, state: FloatArray, observation: Observation) -> float:
        found = super().evidence_at(state, observation)
        return -abs(found) if self.is_contradicted else found


def test_an_alignment_that_no_image_speaks_for_moves_nothing() -> None:
    # As after a gap with wheels that mislead: the alignment ends near the prediction, where nothing
    # fits, and its own covariance says that it is exact.
    chosen = mixture_settings(start=START, motion=MotionModel(position_floor=0.05))
    model = NeverExplained.of_scene(SCENE, MOUNT, chosen)
    assert isinstance(model, NeverExplained)
    robot = Localizer(SCENE, CAMERA, MOUNT, chosen, np.random.default_rng(0), model)
    sigmas = []
    for number, (state, motion) in enumerate(zip(TRUTH[:6], increments(TRUTH), strict=False)):
        model.is_contradicted = number >= 4
        model.aside = np.array([0.08, 0.0, 0.0]) if number >= 4 else np.zeros(3)
        record = robot.step(photo(state), motion, float(number))
        assert record.status == "tracking"
        assert record.refined_covariance is not None
        sigmas.append(float(np.sqrt(record.refined_covariance[0, 0])))
    assert position_error(record, state, "refined") < 0.02
    # What odometry may have got wrong is stated.
    assert sigmas[5] > sigmas[4] > 2.0 * sigmas[3]
