"""What a robot's camera would see at a pose, and whether that is something to localize by.

A goal may be a fine place to stand and yet show the camera nothing that the map knows: it looks
away from what was photographed, or at a bare wall. The view that the map expects there is rendered
and held against the measurement model as if it were a camera image: what it earns at the pose
itself against "this is not the map", and how much less it earns a little beside. A real image
earns less than that; where even the expected one earns next to nothing, no robot can be docked.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipelines.artifacts.arrays import BoolArray, FloatArray
from pipelines.artifacts.errors import OptionError
from pipelines.dock.planar_motion import behind
from pipelines.dock.settings import DockSettings
from pipelines.geometry.camera import Intrinsics
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.observation import Observation
from pipelines.localize.state_space import PLANAR
from pipelines.render.renderer import Renderer

# What has to be told apart: metres and radians.
POSITION, HEADING = 0.1, math.radians(3.0)
# Of less of the view nothing can be said: share of the used pixels that the map shows.
LEAST_SHOWN = 0.1
# Natural units that the expected view earns at its pose, and that it has to earn less beside.
LEAST_EVIDENCE, LEAST_DIFFERENCE = 5.0, 1.5
# A goal whose view earns less than this is worth a word.
ENOUGH_EVIDENCE = 12.0
# If the view at the staging pose shows nothing, one so much nearer to the goal is taken.
NEARER = (0.75, 0.5, 0.35, 0.2)
# But never one nearer than this, metres: alignment needs a way.
LEAST_STAGING = 0.2
# A pixel of which a mask leaves more than this share counts as used.
FULLY_USED = 0.99


@dataclass(frozen=True)
class Outlook:
    """What the map shows of the view at a pose.

    Attributes:
        shown: share of the used pixels, 0 to 1.
        evidence: that the view earns at its pose, natural units.
        difference: by which it earns less at the likest pose beside.
    """

    shown: float
    evidence: float
    difference: float

    @property
    def is_something(self) -> bool:
        """Whether it could be told from a view of something else."""
        return self.shown >= LEAST_SHOWN and self.evidence >= LEAST_EVIDENCE

    @property
    def is_exact(self) -> bool:
        """Whether it could be told from the views beside, too."""
        return self.is_something and self.difference >= LEAST_DIFFERENCE


class Lookout:
    """Judges views that the robot's camera would have.

    Args:
        renderer: of the scene's photos in colours.
        model: compares states with images.
        base_from_camera: ``(4, 4)`` the camera's mount.
        intrinsics: of the camera, without distortion.
        width: of the views, pixels.
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
        self._used = np.ones((height, width), dtype=np.bool_)
        if mask is not None:
            size = (width, height)
            shares = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            self._used = np.asarray(shares > FULLY_USED, dtype=np.bool_)

    def __call__(self, state: FloatArray) -> Outlook:
        """What the map shows of the view at a state ``(3,)``."""
        poses = (PLANAR.poses(state) @ self._base_from_camera)[None]
        images, covered = self._renderer.render_many(poses, self._intrinsics)
        shown = covered[0] & self._used
        share = float(shown.sum() / max(1, int(self._used.sum())))
        if share < LEAST_SHOWN:
            return Outlook(share, 0.0, 0.0)
        image = np.where(shown[..., None], images[0], np.float32(np.nan)).astype(np.float32)
        beside = [PLANAR.composed(state, step) for step in _STEPS]
        observation = Observation(image, self._intrinsics)
        evidence = self._model.evidence(np.stack([state, *beside]), observation)
        return Outlook(share, float(evidence[0]), float(evidence[0] - evidence[1:].max()))

    def check_goal(self, goal: FloatArray) -> str:
        """Makes sure that the camera sees at a goal ``(3,)`` what the map shows.

        Returns:
            A note where that is little; else empty.

        Raises:
            OptionError: it is nothing, or nothing that could tell the goal from beside it.
        """
        outlook = self(goal)
        degrees = math.degrees(math.remainder(float(goal[2]), 2.0 * math.pi))
        place = f"the goal {goal[0]:.2f},{goal[1]:.2f},{degrees:.0f}"
        remedy = (
            "choose a pose from which the robot's camera looks at what the photos show, or add "
            "photos taken there to the map"
        )
        if outlook.shown < LEAST_SHOWN:
            raise OptionError(
                f"{place}: the map shows {outlook.shown:.0%} of what the camera would see there; "
                f"{remedy}"
            )
        if not outlook.is_exact:
            raise OptionError(
                f"{place}: what the map shows of the view there is too plain to tell "
                f"{100.0 * POSITION:.0f} cm and {math.degrees(HEADING):.0f} degrees apart; {remedy}"
            )
        if outlook.evidence < ENOUGH_EVIDENCE:
            return (
                f"the map shows little at {place} ({outlook.shown:.0%} of the view): it may not "
                "be enough to dock by"
            )
        return ""

    def staged(self, goal: FloatArray, settings: DockSettings) -> tuple[DockSettings, str]:
        """Settings whose staging pose the map shows, and a note where it had to be another one.

        A robot in a narrow passage keeps the one that was chosen: it lies before the passage.

        Args:
            goal: ``(3,)``.
            settings: of the docking.
        """
        distance = settings.staging_distance
        if self(behind(goal, distance)).is_something:
            return settings, ""
        trouble = f"the map shows nothing of the view at the staging pose, {distance:g} m back"
        for share in NEARER if settings.robot_radius == 0.0 else ():
            nearer = share * distance
            if nearer >= LEAST_STAGING and self(behind(goal, nearer)).is_something:
                note = f"{trouble}: it is {nearer:.2f} m behind the goal instead"
                return replace(settings, staging_distance=nearer), note
        return settings, f"{trouble}; the robot may not find the goal from there"


_STEPS = np.array(
    [
        [POSITION, 0.0, 0.0],
        [-POSITION, 0.0, 0.0],
        [0.0, POSITION, 0.0],
        [0.0, -POSITION, 0.0],
        [0.0, 0.0, HEADING],
        [0.0, 0.0, -HEADING],
    ]
)
