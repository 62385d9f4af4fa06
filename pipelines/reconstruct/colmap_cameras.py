"""COLMAP's camera models: which of them this project's models describe exactly.

Those that bend light about the optical axis by a polynomial of the angle, with at most four
coefficients, are OPENCV_FISHEYE. Of others the distortion may happen to be none.
"""

from collections.abc import Callable, Sequence

from pipelines.geometry.camera import CAMERA_MODELS

# Model -> the number that COLMAP's files use, and how many parameters it has.
COLMAP_MODELS: dict[str, tuple[int, int]] = {
    "SIMPLE_PINHOLE": (0, 3),
    "PINHOLE": (1, 4),
    "SIMPLE_RADIAL": (2, 4),
    "RADIAL": (3, 5),
    "OPENCV": (4, 8),
    "OPENCV_FISHEYE": (5, 8),
    "FULL_OPENCV": (6, 12),
    "FOV": (7, 5),
    "SIMPLE_RADIAL_FISHEYE": (8, 4),
    "RADIAL_FISHEYE": (9, 5),
    "THIN_PRISM_FISHEYE": (10, 12),
    "RAD_TAN_THIN_PRISM_FISHEYE": (11, 16),
    "SIMPLE_DIVISION": (12, 4),
    "DIVISION": (13, 5),
    "SIMPLE_FISHEYE": (14, 3),
    "FISHEYE": (15, 4),
    "EUCM": (16, 6),
    "EQUIRECTANGULAR": (17, 2),
}
MODEL_NAMES = {number: name for name, (number, _) in COLMAP_MODELS.items()}
MODEL_NUMBERS = {name: COLMAP_MODELS[name][0] for name in CAMERA_MODELS}

UNDISTORT = (
    "undistort first: colmap image_undistorter --image_path images --input_path sparse/0 "
    "--output_path undistorted"
)
CUT = "cut pinhole images out of the panoramas first"

Params = tuple[float, ...]


def exact_camera(model: str, params: Sequence[float]) -> tuple[str, Params] | None:
    """The same camera as one of ``CAMERA_MODELS``.

    Args:
        model: one of ``COLMAP_MODELS``.
        params: as many as it has.

    Returns:
        Model and parameters; None where there is no exact counterpart.
    """
    if model in CAMERA_MODELS:
        return model, tuple(params)
    convert = _EXACT.get(model)
    return None if convert is None else convert(tuple(params))


def remedy_for(model: str) -> str:
    """What can be done about a model without a counterpart."""
    return CUT if model == "EQUIRECTANGULAR" else UNDISTORT


def _fisheye(pinhole: Params, coefficients: Params) -> tuple[str, Params]:
    padded = (*coefficients, 0.0, 0.0, 0.0, 0.0)[:4]
    return "OPENCV_FISHEYE", (*pinhole, *padded)


def _one_focal(params: Params) -> Params:
    """Fx fy cx cy of parameters that begin with f cx cy."""
    focal, *centre = params[:3]
    return (focal, focal, *centre)


def _thin_prism(params: Params) -> tuple[str, Params] | None:
    k1, k2, p1, p2, k3, k4, sx1, sy1 = params[4:]
    return None if any((p1, p2, sx1, sy1)) else _fisheye(params[:4], (k1, k2, k3, k4))


def _tangential_thin_prism(params: Params) -> tuple[str, Params] | None:
    return None if any(params[8:]) else _fisheye(params[:4], params[4:8])


def _undistorted(pinhole: Params, distortion: float) -> tuple[str, Params] | None:
    return None if distortion else ("PINHOLE", pinhole)


_EXACT: dict[str, Callable[[Params], tuple[str, Params] | None]] = {
    "SIMPLE_FISHEYE": lambda params: _fisheye(_one_focal(params), ()),
    "FISHEYE": lambda params: _fisheye(params, ()),
    "SIMPLE_RADIAL_FISHEYE": lambda params: _fisheye(_one_focal(params), params[3:]),
    "RADIAL_FISHEYE": lambda params: _fisheye(_one_focal(params), params[3:]),
    "THIN_PRISM_FISHEYE": _thin_prism,
    "RAD_TAN_THIN_PRISM_FISHEYE": _tangential_thin_prism,
    "FOV": lambda params: _undistorted(params[:4], params[4]),
    "SIMPLE_DIVISION": lambda params: _undistorted(_one_focal(params), params[3]),
    "DIVISION": lambda params: _undistorted(params[:4], params[4]),
    "EUCM": lambda params: _undistorted(params[:4], params[4]),
}
