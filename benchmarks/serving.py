"""``lfnav serve`` under load: latency, memory and isolation with many sessions at once.

    python -m benchmarks.serving SCENE --requests 10000

SCENE is one of the lobby (``make demo`` makes it: ``out/demo/scene.h5``). Each session drives to
and fro along the lobby's test sequence; a malformed request comes before every seventh image. Then
the first images of each session are asked again, one session after the other: the answers have to
be the same.
"""

import argparse
import http.client
import json
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes import ROOT
from pipelines.dataset.dataset import Dataset, load_dataset

DRIVE = ROOT / "sample_data" / "elevators" / "test"
MALFORMED_EVERY = 7
# Images whose answers are asked again.
REPEATED = 10
# Status that each kind of malformed request has to be answered with.
MALFORMED: tuple[tuple[str, str, str, bytes, int], ...] = (
    ("POST", "/sessions/{session}/images", "image/jpeg", b"no image", 400),
    ("POST", "/sessions/{session}/images?odometry_increment=nan,0,0", "image/jpeg", b"x", 400),
    ("POST", "/sessions/{session}/images?stamp=-1", "image/jpeg", b"x", 400),
    ("POST", "/sessions/{session}/images", "text/plain", b"x", 415),
    ("POST", "/sessions/nobody/images", "image/jpeg", b"x", 404),
    ("POST", "/sessions", "application/json", b'{"seed": ', 400),
    ("POST", "/sessions", "application/json", b'{"start": {"x_m": 1}}', 400),
    ("PUT", "/sessions", "application/json", b"{}", 405),
    ("POST", "/sessions", "application/json", b" " * 70_000, 413),
)


@dataclass(frozen=True)
class Course:
    """What one session was answered: the filter's part of each answer, and seconds each took.

    The first images are searched in the whole map, which takes longest.
    """

    answers: list[dict[str, Any]]
    first: list[float]
    seconds: list[float]
    malformed: list[float]
    wrong: Counter[str]


class Client:
    """A connection that is kept."""

    def __init__(self, port: int) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=600)

    def ask(self, method: str, path: str, kind: str, content: bytes) -> tuple[int, Any, float]:
        """Status, JSON, and seconds."""
        start = time.perf_counter()
        self._connection.request(method, path, content, {"Content-Type": kind})
        response = self._connection.getresponse()
        data = response.read()
        return response.status, json.loads(data or b"null"), time.perf_counter() - start


def drive(port: int, data: Dataset, seed: int, images: int, malformed: bool) -> Course:
    """Makes a session, sends it images to and fro, and ends it."""
    client = Client(port)
    wanted = json.dumps({"seed": seed}).encode()
    status, made, _ = client.ask("POST", "/sessions", "application/json", wanted)
    if status != 201:
        raise RuntimeError(made)
    session, rows = made["session"], odometry_rows()
    course = Course([], [], [], [], Counter())
    for number in range(images):
        if malformed and number % MALFORMED_EVERY == MALFORMED_EVERY - 1:
            method, path, kind, content, expected = MALFORMED[
                (number // MALFORMED_EVERY + seed) % len(MALFORMED)
            ]
            path = path.format(session=session)
            status, answer, seconds = client.ask(method, path, kind, content)
            course.malformed.append(seconds)
            if status != expected or list(answer) != ["error"]:
                course.wrong[f"{status} instead of {expected}: {answer}"] += 1
        turn = number % (2 * len(data) - 2)
        index = turn if turn < len(data) else 2 * len(data) - 2 - turn
        path = f"/sessions/{session}/images?odometry_pose={rows[index]}&stamp={number}"
        image = data.read_image_bytes(index)
        status, answer, seconds = client.ask("POST", path, "image/jpeg", image)
        (course.seconds if course.first else course.first).append(seconds)
        if status != 200:
            course.wrong[f"{status} instead of 200: {answer}"] += 1
            continue
        course.answers.append({key: answer[key] for key in ("status", "pose", "modes", "stamp")})
    client.ask("DELETE", f"/sessions/{session}", "", b"")
    return course


def odometry_rows() -> list[str]:
    """Poses of the drive as a request holds them."""
    lines = (DRIVE / "odometry.txt").read_text(encoding="utf-8").splitlines()
    return [",".join(line.split()[1:]) for line in lines if not line.startswith("#")]


def megabytes_of(process: int) -> float:
    """The resident memory of a process."""
    text = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    return int(text.split("VmRSS:")[1].split()[0]) / 1024.0


def measure(scene: Path, requests: int, sessions: int) -> dict[str, Any]:
    """Serves, asks, and says how it went."""
    command = [sys.executable, "-m", "lfnav_cli.main", "serve", str(scene), "--port", "0"]
    options = ["--max-rate", "100000", "--max-sessions", str(2 * sessions)]
    data = load_dataset(DRIVE)
    with subprocess.Popen([*command, *options], stdout=subprocess.PIPE, text=True) as server:
        try:
            line = server.stdout.readline() if server.stdout else ""
            found = re.search(r"127\.0\.0\.1:(\d+)", line)
            if found is None:
                raise RuntimeError("the server does not start")
            port = int(found[1])
            # In four parts, each with sessions of its own: memory that leaks grows from part to
            # part, and what the first one fills is no leak.
            memory, courses = [megabytes_of(server.pid)], []
            each = max(1, requests * MALFORMED_EVERY // (MALFORMED_EVERY + 1) // sessions // 4)
            start = time.perf_counter()
            for _ in range(4):
                with ThreadPoolExecutor(sessions) as clients:
                    part = list(
                        clients.map(lambda s: drive(port, data, s, each, True), range(sessions))
                    )
                courses.append(part)
                memory.append(megabytes_of(server.pid))
            wall = time.perf_counter() - start
            # Without others beside them, and without malformed requests between.
            repeated = min(REPEATED, each)
            alone = [drive(port, data, seed, repeated, False) for seed in range(sessions)]
        finally:
            server.send_signal(signal.SIGTERM)
    everything = [course for part in courses for course in part]
    same = sum(
        course.answers[: len(lonely.answers)] == lonely.answers
        for part in courses
        for course, lonely in zip(part, alone, strict=True)
    )
    seconds = [time for course in everything for time in course.seconds]
    first = [time for course in everything for time in course.first]
    malformed = [time for course in everything for time in course.malformed]
    count = len(first) + len(seconds) + len(malformed)
    return {
        "requests": count,
        "malformed": len(malformed),
        "wrong": dict(sum((course.wrong for course in everything), Counter[str]())),
        "sessions_with_the_same_answers_alone": f"{same} of {len(everything)}",
        "requests_per_second": round(count / wall, 2),
        "first_image_ms": percentiles(first),
        "image_ms": percentiles(seconds),
        "malformed_ms": percentiles(malformed),
        "server_mb_before_and_after_each_quarter": [round(each, 1) for each in memory],
        "exit_code": server.returncode,
    }


def percentiles(seconds: list[float]) -> dict[str, float]:
    """Milliseconds of the usual, the slow and the slowest."""
    if not seconds:
        return {}
    values = np.array(seconds) * 1000.0
    shown = {f"p{share}": float(np.percentile(values, share)) for share in (50, 90, 99)}
    return {name: round(value, 1) for name, value in {**shown, "max": values.max()}.items()}


def main() -> None:
    """Prints the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--requests", type=int, default=10_000)
    parser.add_argument("--sessions", type=int, default=8)
    given = parser.parse_args()
    print(json.dumps(measure(given.scene, given.requests, given.sessions), indent=2))


if __name__ == "__main__":
    main()
