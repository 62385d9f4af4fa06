"""Sessions without HTTP, tokens, limits, and what stands before the application."""

import asyncio
import threading
from collections.abc import Callable, MutableMapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipelines.artifacts.errors import InputError, OptionError, StageError
from pipelines.dataset.images import encode_png
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR, SPATIAL
from pipelines.render.devices import Device
from pipelines.serve.limits import MOST_WAITING, Limits, RateLimit
from pipelines.serve.robot_camera import (
    RobotCamera,
    camera_of_file,
    camera_of_map,
    camera_of_request,
)
from pipelines.serve.sessions import (
    BusyError,
    Motion,
    NoSuchSessionError,
    Session,
    SessionRequest,
    Sessions,
)
from pipelines.serve.stage import ServeRequest, check_libraries, serve
from pipelines.serve.tokens import ANYBODY, Tokens, read_token_file, token_of_environment
from tests.chain_samples import ELEVATORS
from tests.report_samples import CAMERA, MOUNT, facing_wall, painted, photo, wall_scene
from tests.sequence_samples import mixture_settings

ROBOT = RobotCamera(CAMERA, MOUNT)
IMAGE = encode_png(photo(facing_wall(-0.4, 1.7, 0.15), paint=painted))


@pytest.fixture(scope="module")
def sessions() -> Sessions:
    return Sessions(wall_scene(painted), mixture_settings(), ROBOT, Limits(rate=1e6))


class Fake:
    """What stands for a localizer; its steps wait until they may go on."""

    def __init__(self, step: Callable[..., Any]) -> None:
        self.step, self.space, self.notes = step, PLANAR, ()


def session_of(step: Callable[..., Any], limits: Limits | None = None) -> Session:
    limits = Limits(rate=1e6) if limits is None else limits
    return Session("", SessionRequest(), ROBOT, lambda: Fake(step), (), limits)  # type: ignore[arg-type,return-value]


def test_images_of_a_session_are_taken_in_order_and_those_of_others_beside(
    sessions: Sessions,
) -> None:
    one, other = (sessions.create("", SessionRequest(seed=seed)) for seed in (0, 1))
    gate, stamps = threading.Event(), []
    own = one.ready.result()

    def step(image: Any, increment: Any, stamp: float) -> Any:
        gate.wait(60.0)
        stamps.append(stamp)
        return own.step(image, increment, stamp)

    slow = session_of(step)
    futures = [slow.locate(IMAGE, Motion(), float(stamp)) for stamp in range(4)]
    assert other.locate(IMAGE, Motion(), None).result()["image"] == 0
    assert not any(future.done() for future in futures)
    gate.set()
    assert [future.result()["image"] for future in futures] == [0, 1, 2, 3]
    assert stamps == [0.0, 1.0, 2.0, 3.0]
    for session in (one, other):
        sessions.close(session)


def test_only_so_many_wait_and_a_session_that_works_is_not_idle() -> None:
    session = session_of(lambda *_: None)
    places = [session.place() for _ in range(MOST_WAITING)]
    for place in places:
        place.__enter__()
    with pytest.raises(BusyError, match=str(MOST_WAITING)), session.place():
        pass
    assert session.idle_seconds == 0.0
    for place in places:
        place.__exit__(None, None, None)
    with session.place():
        pass
    assert session.idle_seconds > 0.0


@pytest.mark.parametrize(
    ("error", "raised", "ends"),
    [
        (OptionError("refused"), OptionError, False),
        (InputError("/secret/scene.h5", "is damaged"), StageError, True),
        (ValueError("defect"), ValueError, True),
        (MemoryError(), MemoryError, True),
    ],
)
def test_a_filter_that_failed_midway_is_not_asked_again(
    error: Exception, raised: type[Exception], ends: bool
) -> None:
    def step(*_: Any) -> Any:
        raise error

    session = session_of(step)
    with pytest.raises(raised) as caught:
        session.locate(IMAGE, Motion(), None).result()
    assert "secret" not in str(caught.value)
    with pytest.raises(NoSuchSessionError if ends else raised):
        session.locate(IMAGE, Motion(), None).result()


def test_a_closed_session_refuses_what_waits() -> None:
    gate = threading.Event()
    session = session_of(lambda *_: gate.wait(60.0))
    session.locate(IMAGE, Motion(), None)
    waiting = session.locate(IMAGE, Motion(), None)
    session.close()
    gate.set()
    with pytest.raises(NoSuchSessionError):
        waiting.result()
    with pytest.raises(NoSuchSessionError):
        session.locate(IMAGE, Motion(), None)


def test_a_session_whose_localizer_cannot_be_made_names_no_file() -> None:
    def make() -> Any:
        raise InputError("/secret/scene.h5", "is damaged")

    session = Session("", SessionRequest(), ROBOT, make, (), Limits())
    with pytest.raises(StageError) as caught:
        session.ready.result()
    assert "secret" not in str(caught.value)
    with pytest.raises(StageError):
        session.locate(IMAGE, Motion(), None).result()


def test_settings_that_cannot_be_served_are_refused() -> None:
    scene = wall_scene(painted)
    with pytest.raises(OptionError, match="GPU"):
        Sessions(scene, LocalizerSettings(device=Device.GPU))
    with pytest.raises(OptionError, match="PnP"):
        Sessions(scene, LocalizerSettings(with_pnp=True))
    with pytest.raises(OptionError, match="area"):
        Sessions(scene, LocalizerSettings(area=(900.0, 901.0, 900.0, 901.0)))
    nobodys = Sessions(scene, mixture_settings())
    with pytest.raises(OptionError, match="camera"):
        nobodys.create("", SessionRequest())


def test_cameras_come_from_files_requests_and_the_map(tmp_path: Path) -> None:
    path = ELEVATORS / "test" / "camera.toml"
    robot = camera_of_file(path, None, PLANAR)
    again = camera_of_request(robot.to_dict(), PLANAR)
    assert again.camera == robot.camera
    np.testing.assert_allclose(again.body_from_camera, robot.body_from_camera, atol=1e-12)
    used = np.full((robot.camera.height, robot.camera.width), 255, dtype=np.uint8)
    used[-100:] = 0
    (tmp_path / "mask.png").write_bytes(encode_png(used))
    masked = camera_of_file(path, tmp_path / "mask.png", PLANAR)
    assert masked.mask is not None
    np.testing.assert_array_equal(masked.mask, used > 0)
    scene = wall_scene(painted)
    mapped = camera_of_map(replace(scene, base_from_camera=MOUNT), PLANAR)
    assert mapped is not None
    assert mapped.camera == scene.cameras[0]
    np.testing.assert_array_equal(mapped.body_from_camera, MOUNT)
    assert camera_of_map(replace(scene, base_from_camera=None), PLANAR) is None
    assert camera_of_map(replace(scene, base_from_camera=None), SPATIAL) is not None


def test_a_rate_allows_a_second_of_itself_at_once() -> None:
    now = [0.0]
    limit = RateLimit(4.0, lambda: now[0])
    assert [limit.take() for _ in range(5)] == [0.0, 0.0, 0.0, 0.0, 0.25]
    now[0] = 0.25
    assert limit.take() == 0.0
    assert limit.take() > 0.0
    now[0] = 100.0
    assert sum(limit.take() == 0.0 for _ in range(10)) == 4
    slow = RateLimit(0.1, lambda: now[0])
    assert slow.take() == 0.0
    assert slow.take() == pytest.approx(10.0)


@pytest.mark.parametrize(
    "wrong", [{"sessions": 0}, {"rate": -1.0}, {"megapixels": 1e9}, {"megabytes": float("nan")}]
)
def test_limits_have_limits(wrong: dict[str, Any]) -> None:
    with pytest.raises(OptionError):
        Limits(**wrong)


def test_tokens_tell_owners_apart(tmp_path: Path) -> None:
    first, second = "a" * 16, "b" * 40
    path = tmp_path / "tokens"
    path.write_text(f"\n # robots\n{first}\n  {second}  \n")
    tokens = read_token_file(path)
    owners = [tokens.owner_of(f"Bearer {token}".encode()) for token in (first, second)]
    assert owners[0] != owners[1]
    assert None not in owners
    assert first not in str(owners)
    assert tokens.owner_of(f"bearer  {first} ".encode()) == owners[0]
    for header in (None, b"", b"Bearer", b"Bearer " + b"a" * 15, b"Basic " + first.encode()):
        assert tokens.owner_of(header) is None
    assert Tokens().owner_of(None) == ANYBODY
    assert token_of_environment("NAME", first).owner_of(f"Bearer {first}".encode()) == owners[0]


@pytest.mark.parametrize("token", ["short", "ä" * 16, "a" * 600, "with a blank in it"])
def test_poor_tokens_are_refused_and_not_shown(tmp_path: Path, token: str) -> None:
    path = tmp_path / "tokens"
    path.write_text(token)
    with pytest.raises(InputError, match="openssl") as of_file:
        read_token_file(path)
    with pytest.raises(OptionError, match="openssl") as of_environment:
        token_of_environment("NAME", token)
    for caught in (of_file.value, of_environment.value):
        assert token not in str(caught)


def test_missing_libraries_are_said_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(OptionError, match=r"lfnav\[serve\]"):
        check_libraries()
    with pytest.raises(OptionError, match=r"lfnav\[serve\]"):
        serve(ServeRequest(Path("scene.h5")), print)


def test_a_defect_is_answered_without_its_place(caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("fastapi", reason="no fastapi: pip install 'lfnav[serve]'")
    from pipelines.serve.admission import Admission

    async def defect(*_: Any) -> None:
        raise ValueError("secret")

    async def receive() -> MutableMapping[str, Any]:
        return {"type": "http.request", "body": b""}

    sent: list[MutableMapping[str, Any]] = []

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "method": "GET",
        "path": "/scene",
        "query_string": b"",
        "headers": [(b"host", b"localhost")],
    }
    app = Admission(defect, Tokens(), Limits(), "127.0.0.1")
    asyncio.run(app(scope, receive, send))
    assert sent[0]["status"] == 500
    assert b"secret" not in sent[1]["body"]
    assert "ValueError: secret" in caplog.text
