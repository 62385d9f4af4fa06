"""A server in a process of its own, and what asks it, over HTTP."""

import http.client
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# Starts the command line as its console script does.
LFNAV = (sys.executable, "-c", "from lfnav_cli.main import run; run()")
# The same with limits that the command line has no options for: SCENE TOKENS IDLE_SECONDS.
STRICT = (
    sys.executable,
    "-c",
    "import sys\n"
    "from pathlib import Path\n"
    "from pipelines.serve.limits import Limits\n"
    "from pipelines.serve.stage import ServeRequest, serve\n"
    "from pipelines.serve.tokens import read_token_file\n"
    "limits = Limits(megabytes=0.25, megapixels=0.5, rate=0.2, sessions=2,\n"
    "                idle_seconds=float(sys.argv[3]), header_seconds=3.0, content_seconds=3.0)\n"
    "tokens = read_token_file(Path(sys.argv[2]))\n"
    "request = ServeRequest(Path(sys.argv[1]), port=0, tokens=tokens, limits=limits)\n"
    "serve(request, lambda url: print(url, flush=True))\n",
)


@dataclass(frozen=True)
class Answer:
    """What a server said: its status, its JSON or None, and its headers in lower case."""

    status: int
    content: Any
    headers: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Server:
    """A running server."""

    process: "subprocess.Popen[str]"
    host: str
    port: int

    def ask(
        self,
        method: str,
        path: str,
        content: bytes | dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
    ) -> Answer:
        """One request on a connection of its own."""
        sent = dict(headers or {})
        if isinstance(content, dict):
            content = json.dumps(content).encode()
            sent = {"Content-Type": "application/json", **sent}
        connection = http.client.HTTPConnection(self.host, self.port, timeout=120)
        try:
            connection.request(method, path, content, sent)
            return read_answer(connection.getresponse())
        finally:
            connection.close()

    def make_session(self, **wanted: Any) -> str:
        """A new session's identifier."""
        answer = self.ask("POST", "/sessions", wanted)
        assert answer.status == 201, answer
        return str(answer.content["session"])

    def locate(self, session: str, image: bytes, query: str = "") -> Answer:
        """An image, posted."""
        return self.ask(
            "POST", f"/sessions/{session}/images{query}", image, {"Content-Type": "image/jpeg"}
        )


def read_answer(response: http.client.HTTPResponse) -> Answer:
    """An answer, whose content has to be JSON unless it is a page."""
    data = response.read()
    headers = {name.lower(): value for name, value in response.getheaders()}
    is_json = headers.get("content-type") == "application/json"
    return Answer(response.status, json.loads(data) if is_json else data, headers)


@contextmanager
def running_server(*arguments: str | Path, program: tuple[str, ...] = LFNAV) -> Iterator[Server]:
    """A server on a port that is free, which is stopped at the end of the block."""
    process = subprocess.Popen(
        [*program, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=None,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"http://([\d.]+):(\d+)", line)
        if found is None:
            process.kill()
            raise AssertionError(f"no server: {line} {process.communicate()[1]}")
        yield Server(process, found[1], int(found[2]))
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        try:
            process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise
