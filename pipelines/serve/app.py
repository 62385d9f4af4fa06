"""The interface in HTTP: what is asked where, and which error has which number.

A request is checked before by ``admission``. Whatever goes wrong is answered by one line,
``{"error": "..."}``, and a number from 400 on.
"""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, FastAPI, Query, Request, Security
from fastapi.exceptions import RequestValidationError
from fastapi.security import HTTPBearer
from fastapi_offline import FastAPIOffline
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response

from pipelines.artifacts.arrays import FloatArray
from pipelines.artifacts.errors import LfnavError, OptionError, StageError, quoted
from pipelines.artifacts.provenance import version_of
from pipelines.geometry.pose import pose_from_quaternion
from pipelines.localize.state_space import StateSpace
from pipelines.localize.trajectory_export import STATE_NAMES
from pipelines.serve.admission import DEFECT, IMAGE_TYPES, refusal
from pipelines.serve.robot_camera import camera_of_request
from pipelines.serve.sessions import (
    BusyError,
    ConflictError,
    Motion,
    NoSuchSessionError,
    Session,
    SessionRequest,
    Sessions,
)

# An increment beyond this, in metres or radians, is no motion between two images; a pose beyond
# this is none on a robot's floor.
LARGEST_INCREMENT, LARGEST_POSE = 1e3, 1e7
# From 0 on, to the far side of every calendar.
LARGEST_STAMP = 1e12
MAX_SEED = 2**63 - 1
IMAGE_QUERY = ("odometry_increment", "odometry_pose", "stamp")
# How often idle sessions are looked for, at most; seconds.
IDLE_CHECK_SECONDS = 5.0

_STATUS_OF: tuple[tuple[type[LfnavError], int], ...] = (
    (NoSuchSessionError, 404),
    (ConflictError, 409),
    (BusyError, 429),
    (StageError, 500),
    (LfnavError, 400),
)
_ABOUT = (
    "A robot makes a session, posts its camera images there, and is answered where it is. "
    "Metres, radians and seconds; x forward, y left, z up."
)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class NewSession(_Model):
    """What a session is to be; what is left out is the server's."""

    name: str = Field("", max_length=100, description="for people")
    seed: int = Field(0, ge=0, le=MAX_SEED, description="of the filter's random numbers")
    start: dict[str, float] | None = Field(
        None,
        description="where the robot may be at first, with the names of a pose: x_m, y_m, "
        "heading_rad, or x_m, y_m, z_m, rx_rad, ry_rad, rz_rad; left out: anywhere",
    )
    start_position_sigma_m: float | None = Field(None, description="around start; 0.3 by default")
    start_heading_sigma_rad: float | None = Field(None, description="around start; 10 degrees")
    area_m: list[float] | None = Field(
        None, min_length=4, max_length=4, description="x_min, x_max, y_min, y_max"
    )
    camera: dict[str, Any] | None = Field(
        None,
        description="the keys of a camera.toml: model, width, height, params, and mount with x, y, "
        "z in metres and roll, pitch, yaw in degrees; left out: the server's",
    )


class SessionAnswer(_Model):
    """A session."""

    session: str = Field(description="its identifier")
    name: str
    seed: int
    images: int = Field(description="that were taken so far")
    status: str | None = Field(description="after the last image")
    stamp: float | None = Field(description="of the last image that had one")
    idle_seconds: float
    camera: dict[str, Any]


class ImageAnswer(_Model):
    """Where the robot is. Act on the pose only while the status is tracking."""

    session: str
    image: int = Field(description="its number in the session, from 0")
    stamp: float | None
    status: str = Field(description="tracking, global, lost, blind or stale")
    confidence: float = Field(description="probability of being within 0.1 m and 3 degrees")
    pose: dict[str, float] | None = Field(description="x_m, y_m, heading_rad; null while lost")
    estimate: str | None = Field(description="which of the estimates the pose is")
    covariance: list[list[float]] | None = Field(description="of the pose")
    modes: list[dict[str, float]] = Field(description="places that look alike, and their shares")
    estimates: dict[str, dict[str, float]]
    effective_sample_size: float
    areas: dict[str, float] | None = Field(description="in a world the probability of each area")
    notes: list[str]
    seconds: dict[str, float] = Field(description="that the steps took")


class SceneAnswer(_Model):
    """What robots are localized in."""

    scene: str = Field(description="identifier of this build of the scene model or world")
    lfnav: str
    state: list[str] = Field(description="names of a pose's numbers")
    bounds_m: list[float] = Field(description="x_min, x_max, y_min, y_max")
    areas: list[str]
    has_camera: bool = Field(description="whether sessions may leave their camera out")


class ErrorAnswer(_Model):
    """What went wrong."""

    error: str


def make_app(sessions: Sessions) -> FastAPI:
    """The application that answers for sessions.

    Args:
        sessions: of the scene or world that is served.
    """
    errors = {
        number: {"model": ErrorAnswer, "description": text}
        for number, text in (
            (400, "wrong in itself"),
            (401, "no token"),
            (404, "no such session"),
            (429, "too much at once; Retry-After says when again"),
        )
    }
    app = FastAPIOffline(
        redoc_url=None,
        static_url="/docs/static",
        title="lfnav",
        version=version_of("lfnav") or "unknown",
        description=_ABOUT,
        lifespan=lambda _: _idle_sessions_closed(sessions),
        responses=errors,
        swagger_ui_oauth2_redirect_url="/docs/oauth2-redirect",
        # It would be a service on the internet that checks the description.
        swagger_ui_parameters={"validatorUrl": None},
    )
    app.router.redirect_slashes = False
    _add_errors(app)
    _add_paths(app, sessions)
    return app


@asynccontextmanager
async def _idle_sessions_closed(sessions: Sessions) -> AsyncIterator[None]:
    """Closes sessions while the server runs, idle ones; and all of them at its end."""

    async def watch() -> None:
        while True:
            await asyncio.sleep(min(IDLE_CHECK_SECONDS, sessions.limits.idle_seconds / 4.0))
            sessions.close_idle()

    watcher = asyncio.create_task(watch())
    yield
    watcher.cancel()
    with suppress(asyncio.CancelledError):
        await watcher
    sessions.close_all()


def _add_errors(app: FastAPI) -> None:
    """One line for every error."""

    async def of_http(_: Request, error: Exception) -> Response:
        return refusal(error if isinstance(error, HTTPException) else HTTPException(400))

    async def of_fields(_: Request, error: Exception) -> Response:
        faults = error.errors() if isinstance(error, RequestValidationError) else []
        text = "; ".join(_fault(fault) for fault in faults[:3]) or "the request is malformed"
        return refusal(HTTPException(400, text))

    async def of_lfnav(_: Request, error: Exception) -> Response:
        number = next(number for kind, number in _STATUS_OF if isinstance(error, kind))
        headers = {}
        if isinstance(error, BusyError):
            headers["Retry-After"] = str(math.ceil(error.wait))
        return refusal(HTTPException(number, str(error), headers))

    async def of_departure(_: Request, __: Exception) -> Response:
        return refusal(HTTPException(400, "the client left before its request was complete"))

    async def of_defect(_: Request, __: Exception) -> Response:
        # It is raised on to ``admission``, which logs it.
        return refusal(HTTPException(500, DEFECT))

    app.add_exception_handler(Exception, of_defect)
    app.add_exception_handler(HTTPException, of_http)
    app.add_exception_handler(RequestValidationError, of_fields)
    app.add_exception_handler(LfnavError, of_lfnav)
    app.add_exception_handler(ClientDisconnect, of_departure)


def _fault(fault: Any) -> str:
    """What is wrong with a field, in a line; never its value."""
    place = ".".join(str(part) for part in fault.get("loc", ())[1:])
    return f"{quoted(place)}: {fault.get('msg')}" if place else str(fault.get("msg"))


def _add_paths(app: FastAPI, sessions: Sessions) -> None:
    """What can be asked."""
    # It describes how a token is sent; whether one is needed, and which, ``admission`` has asked.
    router = APIRouter(dependencies=[Security(HTTPBearer(auto_error=False, scheme_name="token"))])

    def found(request: Request, session: str) -> Session:
        return sessions.find(request.state.owner, session)

    @app.get("/health", summary="Whether the server is alive")
    async def health() -> dict[str, str]:
        return {"status": "ok"}

    @router.get("/scene", summary="What robots are localized in", response_model=SceneAnswer)
    async def scene() -> dict[str, Any]:
        served = sessions.scene
        return {
            "scene": served.identifier,
            "lfnav": version_of("lfnav") or "unknown",
            "state": list(STATE_NAMES[sessions.space.name]),
            "bounds_m": np.asarray(served.bounds, dtype=np.float64).tolist(),
            "areas": list(sessions.areas),
            "has_camera": sessions.camera is not None,
        }

    @router.post(
        "/sessions", status_code=201, summary="Make a session", response_model=SessionAnswer
    )
    async def create(request: Request, wanted: NewSession) -> Response:
        session = sessions.create(request.state.owner, _wanted(wanted, sessions.space))
        try:
            await asyncio.wrap_future(session.ready)
        except BaseException:
            sessions.close(session)
            raise
        place = {"Location": f"/sessions/{session.identifier}"}
        return JSONResponse(session.describe(), 201, place)

    @router.get("/sessions", summary="List one's own sessions", response_model=list[SessionAnswer])
    async def list_own(request: Request) -> Response:
        return JSONResponse([one.describe() for one in sessions.of(request.state.owner)])

    @router.get("/sessions/{session}", summary="Describe a session", response_model=SessionAnswer)
    async def describe(request: Request, session: str) -> Response:
        return JSONResponse(found(request, session).describe())

    @router.delete("/sessions/{session}", status_code=204, summary="End a session")
    async def delete(request: Request, session: str) -> Response:
        sessions.close(found(request, session))
        return Response(status_code=204)

    @router.post(
        "/sessions/{session}/images",
        summary="Localize an image",
        response_model=ImageAnswer,
        openapi_extra={
            "requestBody": {
                "required": True,
                "content": {
                    kind: {"schema": {"type": "string", "format": "binary"}} for kind in IMAGE_TYPES
                },
            }
        },
    )
    async def locate(
        request: Request,
        session: str,
        odometry_increment: Annotated[
            str | None,
            Query(description="motion since the image before: forward,left,turn (m, m, rad)"),
        ] = None,
        odometry_pose: Annotated[
            str | None,
            Query(
                description="pose by odometry, in a frame of its own: x,y,heading (m, m, rad), or "
                "x,y,z,qx,qy,qz,qw"
            ),
        ] = None,
        stamp: Annotated[
            float | None,
            Query(ge=0.0, le=LARGEST_STAMP, allow_inf_nan=False, description="seconds"),
        ] = None,
    ) -> Response:
        one = found(request, session)
        _check_query(request)
        motion = _motion(odometry_increment, odometry_pose, sessions.space)
        with one.place():
            data = await request.body()
            if not data:
                raise HTTPException(400, "the request holds no image")
            return JSONResponse(await asyncio.wrap_future(one.locate(data, motion, stamp)))

    app.include_router(router)


def _wanted(wanted: NewSession, space: StateSpace) -> SessionRequest:
    """A request for a session as the sessions take it."""
    names = STATE_NAMES[space.name]
    start = None
    if wanted.start is not None:
        if set(wanted.start) != set(names):
            raise OptionError(f"start has to hold {', '.join(names)} and nothing else")
        start = tuple(wanted.start[name] for name in names)
        if max(map(abs, start)) > LARGEST_POSE:
            raise OptionError(f"start holds a number that is not within ±{LARGEST_POSE:g}")
    camera = None if wanted.camera is None else camera_of_request(wanted.camera, space)
    x_min, x_max, y_min, y_max = wanted.area_m or (0.0, 0.0, 0.0, 0.0)
    return SessionRequest(
        name=wanted.name,
        seed=wanted.seed,
        start=start,
        start_position_sigma=wanted.start_position_sigma_m,
        start_heading_sigma=wanted.start_heading_sigma_rad,
        area=None if wanted.area_m is None else (x_min, x_max, y_min, y_max),
        camera=camera,
    )


def _check_query(request: Request) -> None:
    """Refuses what would be left out in silence."""
    keys = [key for key, _ in request.query_params.multi_items()]
    for key in keys:
        if key not in IMAGE_QUERY:
            known = ", ".join(IMAGE_QUERY)
            raise OptionError(f"there is no parameter {quoted(key)}; there are {known}")
        if keys.count(key) > 1:
            raise OptionError(f"{key} is given twice")


def _motion(increment: str | None, pose: str | None, space: StateSpace) -> Motion:
    """What odometry says."""
    if increment is not None and pose is not None:
        raise OptionError("odometry_increment and odometry_pose exclude each other")
    if increment is not None:
        counts = (space.dimension,)
        return Motion(_numbers("odometry_increment", increment, counts, LARGEST_INCREMENT))
    if pose is None:
        return Motion()
    numbers = _numbers("odometry_pose", pose, (space.dimension, 7), LARGEST_POSE)
    if len(numbers) == space.dimension:
        return Motion(None, space.poses(numbers))
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1.0) > 1e-2:
        raise OptionError(f"the quaternion of odometry_pose has the length {norm:g}, not 1")
    return Motion(None, pose_from_quaternion(numbers[:3], numbers[3:] / norm))


def _numbers(name: str, text: str, counts: tuple[int, ...], largest: float) -> FloatArray:
    """Numbers separated by commas."""
    try:
        numbers = np.array([float(part) for part in text.split(",", max(counts))])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) not in counts:
        wanted = " or ".join(map(str, counts))
        raise OptionError(f"{name} {quoted(text)} is not {wanted} numbers with commas between them")
    if not np.all(np.abs(numbers) <= largest):
        raise OptionError(f"{name} {quoted(text)} holds a number that is not within ±{largest:g}")
    return numbers
