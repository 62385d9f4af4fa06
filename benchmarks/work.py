"""The work that is compared: three photos, a plane, particles, and a camera image.

The photos are as fine as the virtual images, and the virtual cameras stand where all three show
every pixel. Who cannot work out where pixels lie in the photos, and how much each photo counts
there, is given it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.scenes import part_of
from pipelines.artifacts.arrays import Float32Array, FloatArray, ImageArray
from pipelines.geometry.camera import Intrinsics
from pipelines.geometry.pose import BASE_FROM_FORWARD_CAMERA, inverse, pose_from_rotation
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.views import Views
from pipelines.render.choices import Blending
from pipelines.render.delaunay_mesh import pixel_weights
from pipelines.render.renderer import Renderer

# Three photos whose centres span a triangle across the line of sight.
CORNERS = (5, 12, 18)
# The virtual cameras stand this far, in metres, behind the middle of that triangle.
STEP_BACK = 0.25


@dataclass(frozen=True)
class Work:
    """What is to be done for one size of the virtual image.

    Attributes:
        views: three photos at the resolution of the virtual images.
        scene: the light field of these photos.
        poses: ``(M, 4, 4)`` world_from_camera of the particles.
        intrinsics: of the virtual camera.
        query: ``(H, W, 3)`` the camera image.
    """

    views: Views
    scene: Scene
    poses: FloatArray
    intrinsics: Intrinsics
    query: ImageArray


def particle_poses(scene: Scene, count: int) -> FloatArray:
    """Cameras ``(M, 4, 4)`` around a place behind the middle of the three recording centres."""
    rng = np.random.default_rng(0)
    middle = scene.world_from_camera[:, :3, 3].mean(axis=0) - np.array([0.0, STEP_BACK, 0.0])
    forward = Rotation.from_euler("z", 90.0, degrees=True).as_matrix() @ BASE_FROM_FORWARD_CAMERA
    rotations = Rotation.from_rotvec(rng.normal(0.0, np.radians(1.0), (count, 3))).as_matrix()
    return pose_from_rotation(rotations @ forward, middle + rng.normal(0.0, 0.02, (count, 3)))


def work_of(scene: Scene, width: int, height: int, count: int) -> Work:
    """The task for virtual images of ``width`` x ``height`` pixels.

    They are the middle half of the camera's field of view, so that photos of twice the size have
    pixels as large as theirs.
    """
    corners = part_of(scene, CORNERS)
    camera = scene.cameras[0].intrinsics.resized(2 * width, 2 * height)
    middle = replace(
        camera, width=width, height=height, cx=camera.cx - width / 2, cy=camera.cy - height / 2
    )
    renderer = Renderer.of_scene(corners, 2 * width, Blending.DELAUNAY, threads=1)
    poses = particle_poses(corners, count)
    query = renderer.render(poses[0], middle).image
    return Work(renderer.views, corners, poses, middle, query)


def every_other(work: Work) -> Work:
    """The same for every other column and row, as a camera of its own."""
    camera = work.intrinsics
    query = np.ascontiguousarray(work.query[::2, ::2])
    quarter = Intrinsics(
        query.shape[1], query.shape[0], camera.fx / 2, camera.fy / 2, camera.cx / 2, camera.cy / 2
    )
    return replace(work, intrinsics=quarter, query=query)


def homographies(work: Work, pose: FloatArray) -> FloatArray:
    """``(3, 3, 3)``: from virtual pixels over the plane to pixels of each photo.

    The ray r of a pixel meets the plane n . x + d = 0 at C - r (n . C + d) / (n . r).
    """
    plane, centre = work.scene.plane, pose[:3, 3]
    rays = pose[:3, :3] @ np.linalg.inv(work.intrinsics.matrix())
    facing = plane.normal @ rays
    points = float(plane.signed_distance(centre)) * rays - np.outer(centre, facing)
    matrices = [
        pinhole.matrix() @ inverse(camera)[:3]
        for pinhole, camera in zip(work.views.intrinsics, work.scene.world_from_camera, strict=True)
    ]
    return np.array([matrix @ np.vstack([points, -facing]) for matrix in matrices])


def net_weights(work: Work, pose: FloatArray) -> Float32Array:
    """``(3, H, W)``: the weight of each photo at each pixel by the Delaunay mesh, with sum 1."""
    mesh = pixel_weights(work.views.centres, pose, work.intrinsics)
    weights = [np.sum(mesh.weights * (mesh.views == view), axis=-1) for view in range(3)]
    return np.array(weights, dtype=np.float32)
