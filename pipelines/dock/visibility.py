"""Visibility check: whether the map shows enough at a pose for the robot to localize there.

A goal may be a fine place to stand and yet show the camera nothing that the map knows: the camera
looks away from what was photographed, or at a bare wall. The view that the map predicts at the pose
is rendered and compared by the measurement model as if it were a camera image. Two numbers matter:
its evidence at the pose itself against "outside the map", and how much lower the evidence is a
little beside. A real image has less evidence than the predicted one. Where even the prediction has
next to none, no robot can be docked.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dataset.mask import used_in_small
from pipelines.dock.planar_motion import behind
from pipelines.dock.settings import DockSettings
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import PLANAR
from pipelines.render.renderer import Renderer

# Offsets that the predicted view has to tell apart: metres and radians.
POSITION, HEADING = 0.1, math.radians(3.0)
# A view of which the map covers less than this share of the used pixels is not judged further.
LEAST_COVERED = 0.1
# Evidence that the predicted view needs at its pose, and the margin over poses beside; natural
# units.
LEAST_EVIDENCE, LEAST_MARGIN = 5.0, 1.5
# A goal with less evidence than this is accepted with a note.
ENOUGH_EVIDENCE = 12.0
# Where the map shows nothing at the staging pose, the staging distance is reduced to these shares.
NEARER = (0.75, 0.5, 0.35, 0.2)
# A staging pose nearer than this is not taken, metres: alignment needs room.
LEAST_STAGING = 0.2


@dataclass(frozen=True)
class PredictedView:
    """What the map predicts of the camera's view at a pose.

    Attributes:
        covered: share of the used pixels that the map shows, 0 to 1.
        evidence: log-likelihood ratio of the pose against "outside the map", natural units.
        margin: evidence minus that of the most likely pose beside, natural units.
    """

    covered: float
    evidence: float
    margin: float

    @property
    def is_recognizable(self) -> bool:
        """Whether the view can be told from one that shows something else."""
        return self.covered >= LEAST_COVERED and self.evidence >= LEAST_EVIDENCE

    @property
    def is_unambiguous(self) -> bool:
        """Whether it can also be told from the views ``POSITION`` or ``HEADING`` beside."""
        return self.is_recognizable and self.margin >= LEAST_MARGIN


class VisibilityCheck:
    """Predicts the robot camera's views and judges them.

    Args:
        renderer: renders the scene's photos in colours.
        model: the measurement model, which compares states with images.
        base_from_camera: ``(4, 4)`` the camera's mount.
        intrinsics: of the camera, without distortion.
        width: width of the predicted views, pixels.
        mask: ``(height, width)``, True where the camera's images are used; None: everywhere.
    """

    def __init__(
        self,
        renderer: Renderer,
        model: MeasurementModel,
        base_from_camera: FloatArray,
        intrinsics: Intrinsics,
        width: int,
        mask: BoolArray | None = None,
    ) -> None:
        self._renderer, self._model = renderer, model
        self._base_from_camera = base_from_camera
        width = min(width, intrinsics.width)
        height = max(1, round(intrinsics.height * width / intrinsics.width))
        self._intrinsics = intrinsics.resized(width, height)
        self._used = used_in_small(mask, width, height)

    def __call__(self, state: FloatArray) -> PredictedView:
        """The view that the map predicts at a state ``(3,)``."""
        poses = (PLANAR.poses(state) @ self._base_from_camera)[None]
        images, covered = self._renderer.render_many(poses, self._intrinsics)
        shown = covered[0] & self._used
        share = float(shown.sum() / max(1, int(self._used.sum())))
        if share < LEAST_COVERED:
            return PredictedView(share, 0.0, 0.0)
        image = np.where(shown[..., None], images[0], np.float32(np.nan)).astype(np.float32)
        beside = [PLANAR.composed(state, step) for step in _OFFSETS]
        observation = Observation(image, self._intrinsics)
        evidence = self._model.evidence(np.stack([state, *beside]), observation)
        return PredictedView(share, float(evidence[0]), float(evidence[0] - evidence[1:].max()))

    def check_goal(self, goal: FloatArray) -> str:
        """Makes sure that the map shows enough of the camera's view at a goal.

        Args:
            goal: state ``(3,)``.

        Returns:
            A note for the user where the map shows little; else empty.

        Raises:
            OptionError: the map shows nothing of the view, or nothing that tells the goal from
                poses beside it.
        """
        view = self(goal)
        degrees = math.degrees(math.remainder(float(goal[2]), 2.0 * math.pi))
        place = f"the goal {goal[0]:.2f},{goal[1]:.2f},{degrees:.0f}"
        remedy = (
            "choose a pose from which the robot's camera looks at what the photos show, or add "
            "photos taken there to the map"
        )
        if view.covered < LEAST_COVERED:
            raise OptionError(
                f"{place}: the map shows {view.covered:.0%} of what the camera would see there; "
                f"{remedy}"
            )
        if not view.is_unambiguous:
            raise OptionError(
                f"{place}: what the map shows of the view there is too plain to tell "
                f"{100.0 * POSITION:.0f} cm and {math.degrees(HEADING):.0f} degrees apart; {remedy}"
            )
        if view.evidence < ENOUGH_EVIDENCE:
            return (
                f"the map shows little at {place} ({view.covered:.0%} of the view): it may not "
                "be enough to dock by"
            )
        return ""

    def visible_staging(self, goal: FloatArray, settings: DockSettings) -> tuple[DockSettings, str]:
        """Docking settings whose staging pose the map shows, and a note for the user.

        The staging distance is reduced where the map shows nothing at the staging pose. With a
        known robot radius it is kept, since the staging pose then lies before a narrow passage. The
        note is empty where nothing had to be changed.

        Args:
            goal: state ``(3,)``.
            settings: the docking's settings as the user chose them.
        """
        distance = settings.staging_distance
        if self(behind(goal, distance)).is_recognizable:
            return settings, ""
        reason = f"the map shows nothing of the view at the staging pose, {distance:g} m back"
        for share in NEARER if settings.robot_radius == 0.0 else ():
            nearer = share * distance
            if nearer >= LEAST_STAGING and self(behind(goal, nearer)).is_recognizable:
                note = f"{reason}: it is {nearer:.2f} m behind the goal instead"
                return replace(settings, staging_distance=nearer), note
        return settings, f"{reason}; the robot may not find the goal from there"


_OFFSETS = np.array(
    [
        [POSITION, 0.0, 0.0],
        [-POSITION, 0.0, 0.0],
        [0.0, POSITION, 0.0],
        [0.0, -POSITION, 0.0],
        [0.0, 0.0, HEADING],
        [0.0, 0.0, -HEADING],
    ]
)
