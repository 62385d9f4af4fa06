"""CameraInfo, compared with OpenCV's projection, which has the definitions of ROS."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from pipelines.artifacts.errors import InputError
from pipelines.geometry.camera import Camera
from pipelines.ros.camera_info import camera_of_info, info_key, is_rectified

SIZE = (640, 480)
K = [500.0, 0.0, 321.0, 0.0, 510.0, 242.0, 0.0, 0.0, 1.0]
P = [480.0, 0.0, 319.0, 0.0, 0.0, 485.0, 239.0, 0.0, 0.0, 0.0, 1.0, 0.0]
PLUMB_BOB = [0.1, -0.05, 0.001, -0.002, 0.0]
RATIONAL = [0.1, -0.05, 0.001, -0.002, 0.02, 0.3, -0.1, 0.05]
EQUIDISTANT = [0.02, -0.01, 0.003, -0.001]


def camera_info(model: str = "plumb_bob", d: list[float] | None = None, **fields: Any) -> Any:
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0, do_rectify=False)
    values: dict[str, Any] = {
        "width": SIZE[0],
        "height": SIZE[1],
        "distortion_model": model,
        "d": PLUMB_BOB if d is None else d,
        "k": K,
        "r": np.eye(3).ravel().tolist(),
        "p": P,
        "binning_x": 0,
        "binning_y": 0,
        "roi": roi,
    }
    return SimpleNamespace(**(values | fields))


def region(x: int, y: int, width: int, height: int) -> Any:
    return SimpleNamespace(x_offset=x, y_offset=y, width=width, height=height, do_rectify=False)


def rays_by_opencv(pixels: Any, d: list[float], *, fisheye: bool) -> Any:
    matrix = np.reshape(K, (3, 3))
    undistort = cv2.fisheye.undistortPoints if fisheye else cv2.undistortPoints
    flat = undistort(pixels[:, None], matrix, np.array(d))[:, 0]
    return np.column_stack([flat, np.ones(len(pixels))])


@pytest.mark.parametrize(
    ("model", "d", "expected"),
    [
        ("plumb_bob", PLUMB_BOB, "OPENCV"),
        ("plumb_bob", PLUMB_BOB[:4], "OPENCV"),
        ("plumb_bob", [*PLUMB_BOB[:4], 0.03], "FULL_OPENCV"),
        ("plumb_bob", [], "OPENCV"),
        ("rational_polynomial", RATIONAL, "FULL_OPENCV"),
        ("rational_polynomial", [*RATIONAL, 0.0, 0.0, 0.0, 0.0], "FULL_OPENCV"),
        ("equidistant", EQUIDISTANT, "OPENCV_FISHEYE"),
        ("", [], "PINHOLE"),
    ],
)
def test_a_pixel_looks_where_opencv_says(model: str, d: list[float], expected: str) -> None:
    camera = camera_of_info(camera_info(model, d), SIZE, "bag")
    assert camera.model == expected
    pixels = np.array([[100.0, 80.0], [321.0, 242.0], [560.5, 400.25]])
    fisheye = expected == "OPENCV_FISHEYE"
    rays = rays_by_opencv(pixels, d or [0.0] * 4, fisheye=fisheye)
    np.testing.assert_allclose(camera.rays(pixels), rays, atol=1e-9)


def test_ros_1_writes_the_matrices_in_capitals() -> None:
    info = camera_info()
    for key in "dkrp":
        setattr(info, key.upper(), getattr(info, key))
        delattr(info, key)
    assert camera_of_info(info, SIZE, "bag") == camera_of_info(camera_info(), SIZE, "bag")
    assert info_key(info) == info_key(camera_info())


def test_rectified_images_have_the_projection_matrix_and_no_distortion() -> None:
    camera = camera_of_info(camera_info(), SIZE, "bag", rectified=True)
    assert camera == Camera("PINHOLE", *SIZE, (480.0, 485.0, 319.0, 239.0))


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/camera/image_raw", False),
        ("/camera/image_rect", True),
        ("/camera/image_rect_color/compressed", True),
        ("/camera/infra1/image_rect_raw", True),
        ("/rect/image_raw", False),
        ("/direction/image", False),
        ("compressed", False),
        ("", False),
    ],
)
def test_rectified_images_are_known_by_their_topic(topic: str, rectified: bool) -> None:
    assert is_rectified(topic) is rectified


def test_binning_and_region_move_the_pixels() -> None:
    info = camera_info("plumb_bob", [], binning_x=2, binning_y=4, roi=region(100, 40, 400, 320))
    camera = camera_of_info(info, (200, 80), "bag")
    whole = camera_of_info(camera_info("plumb_bob", []), SIZE, "bag")
    # The binned pixel (10, 5) is the mean of the columns 120 and 121, and of the rows 60 to 63.
    binned = camera.rays(np.array([[10.0, 5.0]]))
    np.testing.assert_allclose(binned, whole.rays(np.array([[120.5, 61.5]])), atol=1e-9)


def info_without(key: str) -> Any:
    info = camera_info()
    delattr(info, key)
    return info


@pytest.mark.parametrize(
    ("info", "reason"),
    [
        (camera_info(k=[0.0] * 9), "was not calibrated"),
        (camera_info(k=[-1.0, *K[1:]]), "focal length"),
        (camera_info(k=[float("nan"), *K[1:]]), "not all finite"),
        (camera_info(k=[500.0, 3.0, *K[2:]]), "skewed"),
        (camera_info(k=K[:4]), "no usable CameraInfo"),
        (camera_info(k=None), "no usable CameraInfo"),
        (info_without("k"), "no usable CameraInfo"),
        (camera_info("omni\x1b[31m"), r"'omni\x1b[31m' is not known"),
        (camera_info("plumb_bob", RATIONAL), "8 coefficients"),
        (camera_info("rational_polynomial", [*RATIONAL, 0.1, 0.0, 0.0, 0.0]), "thin prism"),
        (camera_info(binning_x=2), "by their CameraInfo they have 320x480"),
        (camera_info(binning_x=1000), "binning of 1000x1"),
        (camera_info(roi=region(600, 0, 100, 480)), "region of interest"),
        (camera_info(width=320), "by their CameraInfo they have 320x480"),
    ],
)
def test_what_no_camera_can_be_made_of(info: Any, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        camera_of_info(info, SIZE, "drive.bag")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_key_tells_cameras_apart() -> None:
    assert info_key(camera_info()) == info_key(camera_info())
    assert info_key(camera_info()) != info_key(camera_info(binning_x=2))
    assert info_key(camera_info()) != info_key(camera_info(k=[*K[:2], 322.0, *K[3:]]))
