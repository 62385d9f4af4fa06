"""Checks whether a map's recording positions fit a robot that drives on the plane z = 0.

A planar state puts the robot's camera at the height of its mount, wherever it is. That is wrong
where the ground of the map slopes or where z = 0 of the map is not the floor. Neither shows in the
result: an estimate at a wrong height is as narrow as a right one. The views' heights only lead to
notes, never to an error, since a map may be recorded at other heights than it is used at.

Limits, and why:

* Ground: where a robot recorded the map, its mount gives the height of the ground under each view.
  Structure from motion errs by some centimetres, so 20 cm are mentioned.
* Slope: a plane through the recording positions that rises by 30 cm or more and explains 70 % of
  the variance of the heights, from ten views on. A hand that moves up and down at random is
  explained to 0 to 10 % (workshop, floor and hololens maps).
* Spread: 50 cm and three tenths of the viewing distance, more than a hand's ups and downs.
* Gap: the robot's camera is farther from all views' heights than 20 cm and 15 % of the viewing
  distance. Views from another height are interpolated without harm (workshop: the robot's camera
  10 cm below), but from 9 degrees on, what hides what begins to differ.
"""

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.pose import inverse
from pipelines.lightfield.scene import Scene

# Metres, except for the shares; the module's text gives the reasons.
GROUND_TOLERANCE = 0.2
SLOPE_RISE, SLOPE_EXPLAINED, SLOPE_VIEWS = 0.3, 0.7, 10
# A plane steeper than this (rise over run) through the positions is no ground.
STEEPEST_GROUND = 0.35
SPREAD, SPREAD_SHARE = 0.5, 0.3
GAP, GAP_SHARE = 0.2, 0.15
# Percentiles between which most heights lie.
MOST = (5.0, 95.0)
# So many depth maps say how far the surface is, and the cosine from which a ray grazes the plane.
VIEWS_MEASURED, GRAZING = 64, 0.1

UNEVEN_REMEDY = "a planar robot stays on z = 0; --degrees-of-freedom 6 lets it leave the plane"


def notes_on_heights(scene: Scene, camera_height: float) -> tuple[str, ...]:
    """Reasons in the heights of a map's views against a robot on z = 0, a line each.

    Args:
        scene: the map.
        camera_height: height of the robot's camera above the floor, metres.
    """
    centres = scene.world_from_camera[:, :3, 3]
    low, high = np.percentile(centres[:, 2], MOST).tolist()
    distance = viewing_distance(scene)
    notes = []
    uneven = _ground_note(scene) or _slope_note(centres)
    if uneven:
        notes.append(uneven)
    elif high - low > max(SPREAD, SPREAD_SHARE * distance):
        notes.append(
            f"the map's views were taken at heights from {low:.2f} to {high:.2f} m, too far apart "
            f"for one floor; {UNEVEN_REMEDY}"
        )
    gap = max(low - camera_height, camera_height - high)
    if gap > max(GAP, GAP_SHARE * distance):
        heights = f"{low:.2f}" if high - low < 0.01 else f"{low:.2f} to {high:.2f}"
        notes.append(
            f"the robot's camera is {camera_height:.2f} m above z = 0 and the map's views at "
            f"{heights} m; check z of [mount] in camera.toml and that z = 0 of the map is the "
            "floor, or give --degrees-of-freedom 6"
        )
    return tuple(notes)


def viewing_distance(scene: Scene) -> float:
    """Metres from the views to the surface that they see, in the median."""
    if scene.depth:
        step = max(1, len(scene.depth) // VIEWS_MEASURED)
        known = [depth.inverse_depth[depth.inverse_depth > 0.0] for depth in scene.depth[::step]]
        medians = [1.0 / float(np.median(values)) for values in known if len(values)]
        if medians:
            return float(np.median(medians))
    poses = scene.world_from_camera
    nearest = np.abs(scene.plane.signed_distance(poses[:, :3, 3]))
    approach = np.abs(poses[:, :3, 2] @ scene.plane.normal)
    return float(np.median(nearest / np.maximum(approach, GRAZING)))


def _ground_note(scene: Scene) -> str | None:
    if scene.base_from_camera is None:
        return None
    heights = (scene.world_from_camera @ inverse(scene.base_from_camera))[:, 2, 3]
    low, high = np.percentile(heights, MOST).tolist()
    if high - low <= GROUND_TOLERANCE:
        return None
    return (
        f"the robot that recorded the map stood at heights from {low:.2f} to {high:.2f} m, so its "
        f"ground is not level; {UNEVEN_REMEDY}"
    )


def _slope_note(centres: FloatArray) -> str | None:
    """About the plane z = a x + b y + c through the recording positions ``(N, 3)``."""
    heights, places = centres[:, 2], centres[:, :2] - centres[:, :2].mean(axis=0)
    deviations = heights - heights.mean()
    if len(centres) < SLOPE_VIEWS:
        return None
    # Positions on a line leave the slope across it open; least squares of least norm takes none.
    slope = np.linalg.lstsq(places, deviations, rcond=1e-6)[0]
    fitted = places @ slope
    rise, run = float(np.ptp(fitted)), float(np.linalg.norm(slope))
    left = float(np.sum((deviations - fitted) ** 2))
    explained = left <= (1.0 - SLOPE_EXPLAINED) * float(np.sum(deviations**2))
    if rise < SLOPE_RISE or run > STEEPEST_GROUND or not explained:
        return None
    return (
        f"the map's views rise by {rise:.2f} m over {rise / run:.0f} m, so its ground is not level "
        f"or its z not upright; {UNEVEN_REMEDY}"
    )
