"""What the apps that record with ARKit have in common: the axes of cameras and of the world.

ARKit's cameras have the axes of OpenGL (x right, y up, z backwards), and its world has y up by
gravity. Exports that somebody has turned on the way have z up; the photos were held upright in one
of the two.
"""

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.dataset.importers.nerfstudio import OPENGL_FROM_OPENCV

# Takes a world with y up to one with z up: x stays.
Z_UP_FROM_Y_UP = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
# Cosine of the angle at which cameras that stand upright on average may lean.
_UPRIGHT = 0.5


def poses_with_z_up(world_from_opengl: FloatArray) -> tuple[FloatArray, str]:
    """Camera poses in lfnav's axes, and a line on what was up.

    Args:
        world_from_opengl: ``(N, 4, 4)`` as exported.

    Returns:
        ``(N, 4, 4)`` world_from_camera, z up, cameras with x right, y down, z forward.
    """
    poses = world_from_opengl @ OPENGL_FROM_OPENCV
    up = -poses[:, :3, 1].mean(axis=0)
    if up[2] > _UPRIGHT and up[2] > up[1]:
        return poses, "the cameras stand upright about the world's z axis, which is kept as up"
    return Z_UP_FROM_Y_UP @ poses, "the world's y axis, ARKit's up, becomes z"
