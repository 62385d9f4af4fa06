"""``lfnav serve``: a real server, asked by a real client."""

import io
import itertools
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pipelines.dataset.dataset import Dataset, load_dataset
from pipelines.lightfield.scene import Scene
from pipelines.lightfield.scene_file import load_scene
from pipelines.localize.localizer import Localizer
from pipelines.localize.measurement_model import MeasurementModel
from pipelines.localize.run import FrameRecord
from pipelines.localize.settings import LocalizerSettings
from pipelines.localize.state_space import PLANAR
from pipelines.serve.answers import answer_of
from tests.chain_samples import ELEVATORS, map_elevators
from tests.serve_samples import LFNAV, STRICT, Answer, Server, running_server

pytest.importorskip("fastapi", reason="no fastapi: pip install 'lfnav[serve]'")

TOKEN, OTHER_TOKEN = "0123456789abcdef-one", "0123456789abcdef-two"
# What two processes do not take equally long.
TIMES = ("seconds",)


@pytest.fixture(scope="module")
def scene_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return map_elevators(tmp_path_factory.mktemp("scene"), "--plane", "0,1,0,0")


@pytest.fixture(scope="module")
def scene(scene_path: Path) -> Scene:
    return load_scene(scene_path)


@pytest.fixture(scope="module")
def drive() -> Dataset:
    return load_dataset(ELEVATORS / "test")


@pytest.fixture(scope="module")
def model(scene: Scene, drive: Dataset) -> MeasurementModel:
    assert drive.base_from_camera is not None
    return MeasurementModel.of_scene(scene, drive.base_from_camera, LocalizerSettings())


@pytest.fixture(scope="module")
def server(scene_path: Path) -> Iterator[Server]:
    with running_server("serve", scene_path, "--port", "0", "--max-rate", "1000") as running:
        yield running


@pytest.fixture(scope="module")
def session(server: Server) -> str:
    """One that takes no image: what is wrong with a request is found before."""
    return server.make_session()


@pytest.fixture(scope="module")
def strict(scene_path: Path) -> Iterator[Server]:
    tokens = scene_path.with_name("tokens.txt")
    tokens.write_text(f"# two robots\n{TOKEN}\n\n{OTHER_TOKEN}\n")
    with running_server(scene_path, tokens, "600", program=STRICT) as running:
        yield running


def increments(drive: Dataset) -> list[Any]:
    assert drive.odometry is not None
    poses = drive.odometry.poses
    pairs = itertools.pairwise(poses)
    return [None, *(PLANAR.increment(before, after) for before, after in pairs)]


def query_of(increment: Any) -> str:
    if increment is None:
        return ""
    return "?odometry_increment=" + ",".join(repr(float(number)) for number in increment)


def said(record: FrameRecord, localizer: Localizer) -> dict[str, Any]:
    """What the server has to say of a record."""
    answer = json.loads(json.dumps(answer_of(record, PLANAR, (), localizer.notes)))
    return {key: value for key, value in answer.items() if key not in TIMES}


def of_filter(answer: Answer) -> dict[str, Any]:
    """What the filter said in an answer."""
    assert answer.status == 200, answer
    about = ("session", "image", "stamp", *TIMES)
    return {key: value for key, value in answer.content.items() if key not in about}


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def png(width: int, height: int, mode: str = "RGB") -> bytes:
    buffer = io.BytesIO()
    Image.new(mode, (width, height)).save(buffer, "PNG")
    return buffer.getvalue()


def assert_refused(answer: Answer, status: int, *words: str) -> None:
    assert answer.status == status, answer
    assert list(answer.content) == ["error"]
    text = answer.content["error"]
    assert text
    assert text == " ".join(text.split())
    assert "Traceback" not in text
    assert len(text) < 500
    for word in words:
        assert word in text


def test_a_session_answers_as_the_localizer_does(
    server: Server, scene: Scene, drive: Dataset, model: MeasurementModel
) -> None:
    localizer = Localizer.of_dataset(scene, drive, seed=3, model=model)
    identifier = server.make_session(seed=3)
    for index, increment in enumerate(increments(drive)[:6]):
        answer = server.locate(identifier, drive.read_image_bytes(index), query_of(increment))
        record = localizer.step(drive.read_image(index), increment)
        assert of_filter(answer) == said(record, localizer)
        assert answer.content["image"] == index
    assert answer.content["status"] == "tracking"
    assert answer.content["estimate"] == "refined"
    assert set(answer.content["pose"]) == {"x_m", "y_m", "heading_rad"}


def test_odometry_may_be_given_as_poses(
    server: Server, scene: Scene, drive: Dataset, model: MeasurementModel
) -> None:
    assert drive.groundtruth is not None
    x, y, heading = PLANAR.states(drive.groundtruth.poses[0])
    start = {"x_m": float(x), "y_m": float(y), "heading_rad": float(heading)}
    settings = LocalizerSettings(start=(float(x), float(y), float(heading)))
    localizer = Localizer.of_dataset(scene, drive, settings, seed=0, model=model)
    whole, flat = (server.make_session(start=start, name="poses") for _ in range(2))
    rows = [
        line.split()[1:]
        for line in (ELEVATORS / "test" / "odometry.txt").read_text().splitlines()
        if not line.startswith("#")
    ]
    for index, increment in enumerate(increments(drive)[:3]):
        stamp = f"&stamp={float(drive.timestamps[index])!r}"
        image = drive.read_image_bytes(index)
        answer = server.locate(whole, image, f"?odometry_pose={','.join(rows[index])}{stamp}")
        record = localizer.step(drive.read_image(index), increment)
        assert of_filter(answer) == said(record, localizer)
        assert answer.content["stamp"] == drive.timestamps[index]
        state = PLANAR.states(drive.odometry.poses[index])  # type: ignore[union-attr]
        text = ",".join(repr(float(number)) for number in state)
        found = server.locate(flat, image, f"?odometry_pose={text}").content["pose"]
        assert found == pytest.approx(answer.content["pose"], abs=1e-6)
    described = server.ask("GET", f"/sessions/{whole}").content
    assert (described["images"], described["name"]) == (3, "poses")
    assert described["camera"]["width"] == 640


def test_eight_sessions_at_once_know_nothing_of_each_other(
    server: Server, scene: Scene, drive: Dataset, model: MeasurementModel
) -> None:
    assert drive.groundtruth is not None
    states = PLANAR.states(drive.groundtruth.poses)
    motions = increments(drive)

    def course(number: int) -> list[int]:
        """Each drives elsewhere."""
        return [2 * number, 2 * number + 1, 2 * number + 2]

    def wanted(number: int) -> tuple[float, ...]:
        x, y, heading = states[course(number)[0]]
        return (float(x), float(y), float(heading))

    def drive_one(number: int) -> list[dict[str, Any]]:
        names = ("x_m", "y_m", "heading_rad")
        start = dict(zip(names, wanted(number), strict=True))
        identifier = server.make_session(seed=number, start=start)
        answers = [
            server.locate(identifier, drive.read_image_bytes(index), query_of(motions[index]))
            for index in course(number)
        ]
        assert server.ask("DELETE", f"/sessions/{identifier}").status == 204
        return [of_filter(answer) for answer in answers]

    with ThreadPoolExecutor(8) as clients:
        found = list(clients.map(drive_one, range(8)))
    for number, answers in enumerate(found):
        settings = LocalizerSettings(start=wanted(number))
        localizer = Localizer.of_dataset(scene, drive, settings, seed=number, model=model)
        for index, answer in zip(course(number), answers, strict=True):
            record = localizer.step(drive.read_image(index), motions[index])
            assert answer == said(record, localizer)


def test_a_client_may_describe_its_camera(server: Server, drive: Dataset) -> None:
    assert drive.camera is not None
    mount = {"x": 0.0, "y": 0.0, "z": 1.0, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    camera = {**drive.camera.to_dict(), "mount": mount}
    area = [-4.0, -2.0, -6.0, -2.0]
    identifier = server.make_session(camera=camera, area_m=area)
    answer = server.locate(identifier, drive.read_image_bytes(0))
    assert answer.content["status"] == "tracking"
    assert -4.0 <= answer.content["pose"]["x_m"] <= -2.0


def test_what_is_served_is_described_without_the_internet(server: Server) -> None:
    assert server.ask("GET", "/health").content == {"status": "ok"}
    scene = server.ask("GET", "/scene").content
    assert scene["state"] == ["x_m", "y_m", "heading_rad"]
    assert scene["has_camera"]
    page = server.ask("GET", "/docs").content.decode()
    linked = [part.split('"')[0] for part in page.replace("'", '"').split('="')]
    assert "http://" not in page
    assert "https://" not in page
    for link in [link for link in linked if link.startswith("/docs/static/")]:
        assert server.ask("GET", link).status == 200
    described = server.ask("GET", "/openapi.json").content
    assert set(described["paths"]) >= {"/sessions", "/sessions/{session}/images"}
    taken = described["paths"]["/sessions/{session}/images"]["post"]
    assert "image/jpeg" in taken["requestBody"]["content"]
    assert {one["name"] for one in taken["parameters"]} >= {"odometry_increment", "stamp"}
    assert "token" in described["components"]["securitySchemes"]


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        (b"{", ["JSON"]),
        (b"[]", []),
        (b"null", []),
        (b"\xff\xfe", []),
        (b"[" * 30000, []),
        (b'{"seed": NaN}', ["seed"]),
        (b'{"start_position_sigma_m": Infinity, "start": null}', ["start_position_sigma_m"]),
        ({"seed": -1}, ["seed"]),
        ({"seed": 2**64}, ["seed"]),
        ({"seed": "0"}, ["seed"]),
        ({"seed": True}, ["seed"]),
        ({"sede": 1}, ["sede"]),
        ({"name": "x" * 101}, ["name"]),
        ({"start": {"x_m": 1.0}}, ["heading_rad"]),
        ({"start": [1, 2, 3]}, ["start"]),
        ({"start": {"x_m": 1e300, "y_m": 0.0, "heading_rad": 0.0}}, []),
        ({"start_position_sigma_m": -1.0}, ["start"]),
        ({"area_m": [0, 1, 2]}, ["area_m"]),
        ({"area_m": [500, 501, 500, 501]}, ["area"]),
        ({"area_m": [1, 0, 1, 0]}, ["area"]),
        ({"camera": {}}, ["camera", "model"]),
        ({"camera": {"model": "PINHOLE", "width": 10, "height": 10, "params": [1]}}, ["params"]),
        (
            {
                "camera": {
                    "model": "PINHOLE",
                    "width": 10**6,
                    "height": 10**6,
                    "params": [1, 1, 0, 0],
                    "mount": dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0),
                }
            },
            ["pixels"],
        ),
        (
            {"camera": {"model": "PINHOLE", "width": 9, "height": 9, "params": [9, 9, 4, 4]}},
            ["mount"],
        ),
    ],
    ids=lambda value: str(value)[:40],
)
def test_wrong_descriptions_of_a_session(
    server: Server, wanted: bytes | dict[str, Any], words: list[str]
) -> None:
    before = len(server.ask("GET", "/sessions").content)
    headers = {"Content-Type": "application/json"}
    assert_refused(server.ask("POST", "/sessions", wanted, headers), 400, *words)
    assert len(server.ask("GET", "/sessions").content) == before


def bomb() -> bytes:
    """A PNG whose header says more than a billion pixels."""
    small = png(1, 1)
    size = (40000).to_bytes(4, "big")
    return small[:16] + size + size + small[24:]


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (b"", ["no image"]),
        (b"GIF89a", ["neither a JPEG, PNG"]),
        (b"\x00" * 1000, ["neither"]),
        (bomb(), ["image"]),
        (png(640, 481), ["640x481", "640x480"]),
        (png(6000, 6000, "1"), ["6000x6000"]),
        (png(640, 480)[:-40], ["the image"]),
        (png(640, 480)[:33], ["the image"]),
    ],
    ids=["empty", "gif", "zeros", "bomb", "size", "large", "truncated", "header"],
)
def test_hostile_images(server: Server, session: str, image: bytes, words: list[str]) -> None:
    assert_refused(server.locate(session, image), 400, *words)
    assert server.ask("GET", f"/sessions/{session}").content["images"] == 0


def test_odd_images_are_taken_as_files_are(server: Server, drive: Dataset) -> None:
    start = {"x_m": 0.0, "y_m": -3.0, "heading_rad": 1.5}
    recorded = Image.fromarray(drive.read_image(0))
    turned, sixteen = io.BytesIO(), io.BytesIO()
    exif = Image.Exif()
    exif[0x0112] = 6  # a quarter turn, which is for people
    recorded.save(turned, "JPEG", exif=exif, quality=90)
    grey = np.asarray(recorded.convert("L")).astype(np.uint16) << 8
    Image.fromarray(grey).save(sixteen, "PNG")
    for data in (turned.getvalue(), sixteen.getvalue()):
        assert server.locate(server.make_session(start=start), data).status == 200


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("odometry_increment=nan,0,0", ["odometry_increment"]),
        ("odometry_increment=inf,0,0", ["odometry_increment"]),
        ("odometry_increment=1e5,0,0", ["odometry_increment"]),
        ("odometry_increment=1,2", ["3 numbers"]),
        ("odometry_increment=1,2,3,4", ["3 numbers"]),
        ("odometry_increment=", ["3 numbers"]),
        ("odometry_increment=" + "9," * 9000, ["3 numbers"]),
        ("odometry_pose=1,2,3,4", ["3 or 7 numbers"]),
        ("odometry_pose=0,0,0,0,0,0,0", ["quaternion"]),
        ("odometry_pose=0,0,nan", ["odometry_pose"]),
        ("odometry_pose=0,0,0&odometry_increment=0,0,0", ["exclude"]),
        ("odometry=0,0,0", ["'odometry'", "odometry_increment"]),
        ("stamp=1&stamp=2", ["twice"]),
        ("stamp=-1", ["stamp"]),
        ("stamp=nan", ["stamp"]),
        ("stamp=1e400", ["stamp"]),
        ("stamp=noon", ["stamp"]),
        ("stamp=%00%1b[31m", ["stamp"]),
    ],
    ids=lambda value: str(value)[:40],
)
def test_wrong_odometry_and_times(
    server: Server, session: str, drive: Dataset, query: str, words: list[str]
) -> None:
    answer = server.locate(session, drive.read_image_bytes(0), f"?{query}")
    assert_refused(answer, 400, *words)
    assert server.ask("GET", f"/sessions/{session}").content["images"] == 0


def test_what_was_refused_leaves_no_trace(
    server: Server, scene: Scene, drive: Dataset, model: MeasurementModel
) -> None:
    localizer = Localizer.of_dataset(scene, drive, seed=5, model=model)
    identifier = server.make_session(seed=5)
    motions = increments(drive)
    for index in range(2):
        data = drive.read_image_bytes(index)
        assert server.locate(identifier, data[:5000], query_of(motions[1])).status == 400
        assert server.locate(identifier, png(10, 10), query_of(motions[1])).status == 400
        answer = server.locate(identifier, data, f"{query_of(motions[index]) or '?'}&stamp={index}")
        record = localizer.step(drive.read_image(index), motions[index])
        assert of_filter(answer) == said(record, localizer)
    assert_refused(server.locate(identifier, data, "?stamp=0.5"), 409, "stamp")


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/", {}, 404),
        ("GET", "/sessions/", {}, 404),
        ("GET", "/../../etc/passwd", {}, 404),
        ("GET", "/docs/static/../core.py", {}, 404),
        ("GET", "/docs/static/%2e%2e/core.py", {}, 404),
        ("GET", "/sessions/none", {}, 404),
        ("DELETE", "/sessions/none", {}, 404),
        ("POST", "/sessions/none/images", {"Content-Type": "image/png"}, 404),
        ("PUT", "/sessions", {}, 405),
        ("OPTIONS", "/sessions", {"Origin": "http://evil.example"}, 403),
        ("TRACE", "/sessions", {}, 405),
        ("POST", "/sessions", {"Content-Type": "text/plain"}, 415),
        ("POST", "/sessions", {"Content-Type": "application/json-patch+json"}, 415),
        ("POST", "/sessions", {}, 415),
        ("GET", "/sessions", {"Host": "evil.example"}, 421),
        ("GET", "/sessions", {"Host": "evil.example:8765"}, 421),
        ("GET", "/sessions", {"Host": "127.0.0.1.evil.example"}, 421),
        ("GET", "/sessions", {"Host": "[::1"}, 421),
        ("GET", "/sessions", {"Host": ""}, 421),
        ("GET", "/docs", {"Host": "evil.example"}, 421),
        ("POST", "/sessions", {"Origin": "http://evil.example"}, 403),
        ("POST", "/sessions", {"Origin": "null"}, 403),
        ("POST", "/sessions", {"Origin": "http://[::1"}, 403),
        ("POST", "/sessions", {"Content-Encoding": "gzip"}, 415),
    ],
)
def test_wrong_requests(
    server: Server, method: str, path: str, headers: dict[str, str], status: int
) -> None:
    content = b"{}" if method == "POST" else None
    answer = server.ask(method, path, content, headers)
    assert_refused(answer, status)
    assert "access-control-allow-origin" not in answer.headers


def test_images_have_a_type_that_pages_cannot_send(server: Server, session: str) -> None:
    for kind in ("text/plain", "multipart/form-data", "application/x-www-form-urlencoded", ""):
        headers = {"Content-Type": kind} if kind else {}
        answer = server.ask("POST", f"/sessions/{session}/images", b"x", headers)
        assert_refused(answer, 415, "image/jpeg")


@pytest.mark.parametrize("called", ["localhost", "127.0.0.1:1", "[::1]:9000", "LOCALHOST:80"])
def test_this_machine_may_be_called_by_its_names(server: Server, called: str) -> None:
    headers = {"Host": called, "Origin": f"http://{called}"}
    assert server.ask("GET", "/sessions", None, headers).status == 200


def raw(server: Server, data: bytes, wait: float = 30.0) -> bytes:
    """What the server says to bytes, until it closes the connection."""
    with socket.create_connection((server.host, server.port), timeout=wait) as connection:
        connection.sendall(data)
        found = b""
        while part := connection.recv(65536):
            found += part
        return found


@pytest.mark.parametrize(
    "data",
    [
        b"hello\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00",
        b"GET / HTTP/9.9\r\nHost: x\r\nConnection: close\r\n\r\n",
        b"GET /\xff HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 100_000 + b"\r\n\r\n",
        b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\n" + b"X: y\r\n" * 20_000 + b"\r\n",
        b"POST /sessions HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    ],
    ids=lambda value: value[:30],
)
def test_what_is_no_http_is_answered_in_a_line(server: Server, data: bytes) -> None:
    try:
        answer = raw(server, data)
    except ConnectionError:
        answer = b""  # it closed the connection before all was sent
    if answer:
        head, _, content = answer.partition(b"\r\n\r\n")
        assert head.split()[1].startswith(b"4")
        assert b"application/json" in head
        assert list(json.loads(content)) == ["error"]
    assert server.ask("GET", "/health").status == 200


def test_a_client_that_leaves_harms_nobody(server: Server, session: str, drive: Dataset) -> None:
    data = drive.read_image_bytes(0)
    head = (
        f"POST /sessions/{session}/images HTTP/1.1\r\nHost: localhost\r\n"
        f"Content-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
    )
    for _ in range(6):
        with socket.create_connection((server.host, server.port)) as connection:
            connection.sendall(head.encode() + data[:1000])
    # Its places are free again.
    identifier = server.make_session(start={"x_m": 0.0, "y_m": -3.0, "heading_rad": 1.5})
    assert server.locate(identifier, data).status == 200
    deadline = time.monotonic() + 20.0
    while server.locate(session, b"").status == 429:
        assert time.monotonic() < deadline


def test_a_token_is_needed_and_sessions_belong_to_it(strict: Server) -> None:
    assert strict.ask("GET", "/health").status == 200
    assert strict.ask("GET", "/docs").status == 200
    for headers in (
        {},
        bearer(TOKEN[:-1]),
        bearer(TOKEN + "x"),
        bearer(""),
        bearer("\xff"),
        {"Authorization": f"Basic {TOKEN}"},
        {"Authorization": TOKEN},
    ):
        answer = strict.ask("POST", "/sessions", {}, headers)
        assert_refused(answer, 401, "token")
        assert answer.headers["www-authenticate"] == "Bearer"
    made = strict.ask("POST", "/sessions", {}, bearer(TOKEN))
    assert made.status == 201
    place = made.headers["location"]
    assert strict.ask("GET", place, None, bearer(TOKEN)).status == 200
    # With a token nobody asks by which name the server was called.
    called = {"Host": "robots.example", **bearer(TOKEN)}
    assert len(strict.ask("GET", "/sessions", None, called).content) == 1
    for method in ("GET", "DELETE"):
        assert_refused(strict.ask(method, place, None, bearer(OTHER_TOKEN)), 404)
    assert strict.ask("GET", "/sessions", None, bearer(OTHER_TOKEN)).content == []
    assert strict.ask("DELETE", place, None, bearer(TOKEN)).status == 204
    assert_refused(strict.ask("DELETE", place, None, bearer(TOKEN)), 404)


def test_sessions_are_few(strict: Server) -> None:
    new_strict_session(strict)
    answers = [strict.ask("POST", "/sessions", {}, bearer(TOKEN)) for _ in range(2)]
    assert answers[0].status == 201
    assert_refused(answers[1], 429, "2 sessions")
    assert int(answers[1].headers["retry-after"]) >= 1


def test_idle_sessions_end(strict: Server, scene_path: Path) -> None:
    tokens = scene_path.with_name("tokens.txt")
    with running_server(scene_path, tokens, "1.0", program=STRICT) as running:
        place = running.ask("POST", "/sessions", {}, bearer(TOKEN)).headers["location"]
        deadline = time.monotonic() + 60.0
        while running.ask("GET", "/sessions", None, bearer(TOKEN)).content:
            assert time.monotonic() < deadline
            time.sleep(0.2)
        assert_refused(running.ask("GET", place, None, bearer(TOKEN)), 404, "idle")


def new_strict_session(strict: Server) -> str:
    for one in strict.ask("GET", "/sessions", None, bearer(TOKEN)).content:
        strict.ask("DELETE", f"/sessions/{one['session']}", None, bearer(TOKEN))
    return str(strict.ask("POST", "/sessions", {}, bearer(TOKEN)).content["session"])


def test_images_are_not_too_many_too_large_or_of_too_many_pixels(strict: Server) -> None:
    path = f"/sessions/{new_strict_session(strict)}/images"
    headers = {"Content-Type": "image/png", **bearer(TOKEN)}
    assert_refused(strict.ask("POST", path, b"x" * 300_000, headers), 413, "262144")
    of_session = {**headers, "Content-Type": "application/json"}
    assert_refused(strict.ask("POST", "/sessions", b" " * 70_000, of_session), 413, "65536")
    chunked = {**headers, "Transfer-Encoding": "chunked"}
    chunks = b"%x\r\n%b\r\n0\r\n\r\n" % (300_000, b"x" * 300_000)
    assert_refused(strict.ask("POST", path, chunks, chunked), 413, "262144")
    answers = [strict.ask("POST", path, b"x", headers) for _ in range(4)]
    refused = [answer for answer in answers if answer.status == 429]
    assert refused
    assert_refused(refused[0], 429, "0.2 images a second")
    camera = {"model": "PINHOLE", "width": 1000, "height": 501, "params": [9.0, 9.0, 4.0, 4.0]}
    mount = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0)
    wanted = {"camera": {**camera, "mount": mount}}
    assert_refused(strict.ask("POST", "/sessions", wanted, bearer(TOKEN)), 400, "500000")


def test_who_announces_too_much_is_told_before_sending(strict: Server) -> None:
    head = (
        "POST /sessions/none/images HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\n"
        f"Authorization: Bearer {TOKEN}\r\nContent-Length: 99999999999\r\n"
        "Content-Type: image/png\r\n\r\n"
    )
    assert b" 413 " in raw(strict, head.encode()).split(b"\r\n")[0]


def test_slow_clients_are_left_and_block_nobody(strict: Server) -> None:
    path = f"/sessions/{new_strict_session(strict)}/images"
    head = (
        f"POST {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n"
        "Content-Type: image/png\r\nContent-Length: 1000\r\n"
    )
    slow = []
    for begun in ("", "GET / HT", head, head + "\r\nabc"):
        connection = socket.create_connection((strict.host, strict.port), timeout=30)
        connection.sendall(begun.encode())
        slow.append(connection)
    assert strict.ask("GET", "/health").status == 200
    refused = socket.create_connection((strict.host, strict.port), timeout=30)
    refused.sendall(head.replace(TOKEN, "wrong").encode() + b"\r\nabc")
    assert b" 401 " in refused.recv(65536).split(b"\r\n")[0]
    for dripping in (slow[1], refused):
        # A byte now and then changes nothing.
        with pytest.raises(OSError):  # noqa: PT011
            for _ in range(400):
                dripping.sendall(b"x")
                time.sleep(0.05)
        dripping.close()
    for connection in [*slow[:1], *slow[2:]]:
        assert b" 408 " in connection.recv(65536).split(b"\r\n")[0]
        connection.close()
    assert strict.ask("GET", "/health").status == 200


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it(scene_path: Path, drive: Dataset, number: signal.Signals) -> None:
    with running_server("serve", scene_path, "--port", "0", "-v") as running:
        identifier = running.make_session()
        with ThreadPoolExecutor(1) as client:
            answer = client.submit(running.locate, identifier, drive.read_image_bytes(0))
            time.sleep(0.2)
            running.process.send_signal(number)
            assert answer.result().status == 200  # what was begun is answered
        assert running.process.wait(60) == 0
        assert running.process.stderr is not None
        log = running.process.stderr.read()
    assert "POST /sessions 201" in log
    assert "Traceback" not in log
    assert all(line.startswith("lfnav: ") for line in log.splitlines())


def run(*arguments: str | Path, **environment: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*LFNAV, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **environment},
    )


def assert_one_line(outcome: "subprocess.CompletedProcess[str]", *words: str) -> None:
    assert outcome.returncode == 1, outcome
    assert outcome.stdout == ""
    assert outcome.stderr.startswith("lfnav: ")
    assert outcome.stderr.count("\n") == 1
    for word in words:
        assert word in outcome.stderr


def test_what_hinders_the_start_is_said_in_a_line(
    server: Server, scene_path: Path, tmp_path: Path
) -> None:
    port = str(server.port)
    assert_one_line(run("serve", scene_path, "--port", port), port, "Address already in use")
    assert_one_line(run("serve", scene_path, "--host", "0.0.0.0", "--port", "0"), "--token-file")
    assert_one_line(run("serve", scene_path, "--port", "70000"), "port")
    assert_one_line(run("serve", scene_path, "--host", "no such host"), "no such host")
    short = run("serve", scene_path, LFNAV_SERVE_TOKEN="short")
    assert_one_line(short, "LFNAV_SERVE_TOKEN", "openssl")
    assert "short" not in short.stderr
    (tmp_path / "tokens").write_text("# none\n")
    assert_one_line(run("serve", scene_path, "--token-file", tmp_path / "tokens"), "no token")
