"""What the apps that record with ARKit have in common: the axes of cameras and of the world.

ARKit's cameras have the axes of OpenGL (x right, y up, z backwards), and its world has y up by
gravity. Exports that somebody has turned on the way have z up; the photos were held upright in one
of the two.
"""

from pathlib import Path

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import InputError, OptionError
from pipelines.dataset.images import read_image_header
from pipelines.dataset.importers.nerfstudio import OPENGL_FROM_OPENCV, PIXEL_CENTRE_SHIFT
from pipelines.geometry.camera import Camera

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


def pinhole_of_photo(
    path: Path, photo: Path, size: tuple[float, float], params: tuple[float, float, float, float]
) -> Camera:
    """The camera of a photo, which may be smaller than the pictures that its file speaks of.

    Args:
        path: the file that says so, for the error.
        photo: the photo as it is.
        size: width and height that the file states.
        params: focal lengths and centre along x and y, of that size, pixel centres at .5.

    Raises:
        InputError: a size or a camera that cannot be.
    """
    header = read_image_header(photo)
    if min(size) <= 0.0:
        raise InputError(path, f"{size[0]:g}x{size[1]:g} is no size of a picture")
    across, down = header.width / size[0], header.height / size[1]
    focal = (across * params[0], down * params[1])
    centre = (across * params[2] - PIXEL_CENTRE_SHIFT, down * params[3] - PIXEL_CENTRE_SHIFT)
    try:
        return Camera("PINHOLE", header.width, header.height, (*focal, *centre))
    except OptionError as error:
        raise InputError(path, str(error)) from error
