"""The fixed part of a top view: mapped surface, recording positions, obstacle points, extent."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.plane import Plane
from pipelines.geometry.pose import camera_heading_of
from pipelines.lightfield.area_map import AreaMap
from pipelines.lightfield.open_world import OpenWorld
from pipelines.lightfield.scene import Scene
from pipelines.report.tracks import Tracks

# A plane whose normal rises less than this (as a share of its length, 0.3 is 17 degrees) is a wall:
# seen from above it is a line.
MAX_WALL_TILT = 0.3
# Rays that meet the surface at more than this many times the median distance are left out: they
# graze it.
MAX_RANGE_FACTOR = 4.0
RAYS_PER_SIDE = 17
# A top view shows at least the particles between these quantiles.
OUTERMOST = (0.005, 0.995)


@dataclass(frozen=True)
class Surface:
    """The part of the mapped surface that the views cover, seen from above.

    Attributes:
        outline: ``(2, 2)`` ends of a wall's trace on the ground, or ``(K, 2)`` corners of the
            covered area of a horizontal surface, metres.
        away: ``(2,)`` unit vector from the visible side through the wall; zero for a horizontal
            surface.
    """

    outline: FloatArray
    away: FloatArray

    @property
    def is_wall(self) -> bool:
        """Whether the surface is a line from above."""
        return bool(np.any(self.away != 0.0))


@dataclass(frozen=True)
class Surroundings:
    """The fixed part of a top view.

    Attributes:
        surface: the mapped surface; None where no view covers any of it, or the
            scene has no plane.
        recordings: ``(V, 3)`` recording positions x, y (metres) and headings (radians).
        extent: ``(4,)`` x_min, x_max, y_min, y_max of the top view, metres.
        obstacles: ``(M, 2)`` obstacle points on the floor, metres; None: not shown.
        areas: of the world, whose recordings are told apart by colour; None: a scene.
    """

    surface: Surface | None
    recordings: FloatArray
    extent: FloatArray
    obstacles: FloatArray | None = None
    areas: AreaMap | None = None


def surroundings_of(
    scene: Scene | OpenWorld, tracks: Tracks, particles: Sequence[FloatArray] = ()
) -> Surroundings:
    """The fixed part of the top views of a run in ``scene``.

    Args:
        scene: the scene model, or the world.
        tracks: the run's paths.
        particles: ``(M, D)`` particles of each frame shown; all but the outermost are in view.
    """
    positions = scene.world_from_camera[:, :2, 3]
    headings = camera_heading_of(scene.world_from_camera)
    surface = None
    if isinstance(scene, Scene) and scene.surface is not None:
        cameras = [scene.camera_of(index) for index in range(len(scene))]
        surface = surface_from_above(scene.plane, scene.world_from_camera, cameras)
    bounds = np.asarray(scene.bounds, dtype=np.float64)
    corners = bounds.reshape(2, 2).T
    known = [corners, positions]
    if surface is not None:
        known.append(surface.outline)
    if tracks.groundtruth is not None:
        known.append(tracks.groundtruth[np.all(np.isfinite(tracks.groundtruth), axis=1), :2])
    # Paths extend the view by half of the place on each side at most: a diverging path must not
    # shrink the place to a dot.
    extent = _box(np.concatenate(known))
    margin = 0.5 * max(extent[1] - extent[0], extent[3] - extent[2])
    limits = extent + np.array([-margin, margin, -margin, margin])
    moving = [path for path in (tracks.estimated, tracks.odometry) if path is not None]
    moving += [np.quantile(cloud, OUTERMOST, axis=0) for cloud in particles]
    for points in moving:
        finite = points[np.all(np.isfinite(points), axis=1), :2]
        known.append(np.clip(finite, limits[[0, 2]], limits[[1, 3]]))
    return Surroundings(
        surface=surface,
        recordings=np.column_stack([positions, headings]),
        extent=_grown(_box(np.concatenate(known)), 0.04),
        areas=scene.area_map if isinstance(scene, OpenWorld) else None,
    )


def _box(points: FloatArray) -> FloatArray:
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([low[0], high[0], low[1], high[1]])


def _grown(extent: FloatArray, share: float) -> FloatArray:
    margin = max(0.25, share * max(extent[1] - extent[0], extent[3] - extent[2]))
    return np.asarray(extent + np.array([-margin, margin, -margin, margin]))


def surface_from_above(
    plane: Plane, world_from_camera: FloatArray, cameras: list[Camera]
) -> Surface | None:
    """The part of a plane that cameras see, from above; None where they see none.

    Args:
        plane: in world coordinates.
        world_from_camera: ``(V, 4, 4)`` poses of the cameras.
        cameras: their intrinsics, ``V`` of them.
    """
    hits = _points_seen(plane, world_from_camera, cameras)
    if len(hits) == 0:
        return None
    horizontal = plane.normal[:2]
    length = float(np.linalg.norm(horizontal))
    if length >= np.sqrt(1.0 - MAX_WALL_TILT**2):
        direction = np.array([-horizontal[1], horizontal[0]]) / length
        # The trace is where z = 0: its nearest point to the origin, and the direction along it.
        foot = -plane.offset * horizontal / length**2
        along = hits[:, :2] @ direction
        ends = foot + np.outer([along.min(), along.max()], direction)
        return Surface(ends, -horizontal / length)
    try:
        corners = hits[scipy.spatial.ConvexHull(hits[:, :2]).vertices, :2]
    except (scipy.spatial.QhullError, ValueError):
        return None
    return Surface(corners, np.zeros(2))


def _points_seen(plane: Plane, world_from_camera: FloatArray, cameras: list[Camera]) -> FloatArray:
    """Points ``(M, 3)`` at which rays through the cameras' images meet the plane."""
    distances = np.abs(plane.signed_distance(world_from_camera[:, :3, 3]))
    longest = MAX_RANGE_FACTOR * max(float(np.median(distances)), 1e-6)
    hits = []
    for pose, camera in zip(world_from_camera, cameras, strict=True):
        pinhole = camera.intrinsics
        columns = np.linspace(-0.5, camera.width - 0.5, RAYS_PER_SIDE)
        rows = np.linspace(-0.5, camera.height - 0.5, RAYS_PER_SIDE)
        u, v = (grid.reshape(-1) for grid in np.meshgrid(columns, rows))
        rays = np.column_stack(
            [(u - pinhole.cx) / pinhole.fx, (v - pinhole.cy) / pinhole.fy, np.ones_like(u)]
        )
        rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ pose[:3, :3].T
        slope = rays @ plane.normal
        meets = np.abs(slope) > 1e-9
        reach = np.full(len(rays), -1.0)
        reach[meets] = -plane.signed_distance(pose[:3, 3]) / slope[meets]
        good = (reach > 0.0) & (reach <= longest)
        hits.append(pose[:3, 3] + reach[good, None] * rays[good])
    return np.concatenate(hits)
