"""The stage ``serve``: a scene model or a world in, answers over HTTP until it is stopped."""

import asyncio
import contextlib
import importlib.util
import ipaddress
import logging
import signal
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from pipelines.artifacts.arguments import checked_number
from pipelines.artifacts.errors import OptionError, quoted
from pipelines.lightfield.open_world import scene_or_world
from pipelines.localize.settings import LocalizerSettings
from pipelines.serve.limits import MAX_HEADER_BYTES, Limits
from pipelines.serve.robot_camera import camera_of_file, camera_of_map
from pipelines.serve.sessions import Sessions
from pipelines.serve.tokens import Tokens

if TYPE_CHECKING:
    import uvicorn

LOOPBACK, PORT = "127.0.0.1", 8765
INSTALL = "pip install 'lfnav[serve]'"
NEEDED = ("fastapi", "fastapi_offline", "uvicorn")
# For which answers that are being computed are waited for at the end, seconds.
GRACE_SECONDS = 5.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ServeRequest:
    """What is served, and to whom.

    Attributes:
        scene: scene model, or the folder of a world of several.
        host: address or name at which the server listens.
        port: the same; 0: one that is free.
        tokens: of which clients have to send one; none: no client has to.
        settings: of the particle filter.
        camera: ``camera.toml`` of sessions that describe none; None: the camera of the map.
        mask: picture of what that camera's images show of the robot.
        memory: megabytes that a session in a world may take; None: 1000.
        limits: what is refused.
    """

    scene: Path
    host: str = LOOPBACK
    port: int = PORT
    tokens: Tokens = field(default_factory=Tokens)
    settings: LocalizerSettings = field(default_factory=LocalizerSettings)
    camera: Path | None = None
    mask: Path | None = None
    memory: float | None = None
    limits: Limits = field(default_factory=Limits)


def serve(request: ServeRequest, announce: Callable[[str], None]) -> None:
    """Serves until the process is told to stop (SIGINT, SIGTERM); in the main thread only.

    Args:
        request: what is served, and to whom.
        announce: called with the server's URL as soon as it answers.

    Raises:
        InputError: an input cannot be used.
        OptionError: settings that make no sense, an address that is not free or not this machine's,
            no token where one is needed, or libraries that are missing.
    """
    check_libraries()
    checked_number(request.port, "port", 0, 65535, whole=True)
    if request.mask is not None and request.camera is None:
        raise OptionError("a mask goes with a camera; give --camera as well")
    with _listening(request.host, request.port) as listener:
        address = listener.getsockname()[0]
        if not len(request.tokens) and not ipaddress.ip_address(address).is_loopback:
            raise OptionError(
                f"{address} can be reached from other machines, so clients need a token; "
                "give --token-file"
            )
        sessions = _sessions(request)
        # From here on: the framework takes half a second.
        from pipelines.serve.admission import Admission
        from pipelines.serve.app import make_app

        app = Admission(make_app(sessions), request.tokens, request.limits, address)
        asyncio.run(_run(_server(app, request.limits), listener, announce))
        sessions.close_all()


def check_libraries() -> None:
    """Refuses to go on without the libraries that serving takes.

    Raises:
        OptionError: one is missing; how to install it is said.
    """
    for name in NEEDED:
        if importlib.util.find_spec(name) is None:
            raise OptionError(f"serving needs {name}; {INSTALL} brings it")


def _sessions(request: ServeRequest) -> Sessions:
    settings = request.settings
    scene = scene_or_world(request.scene, request.memory)
    if request.camera is None:
        camera = camera_of_map(scene, settings.state_space)
    else:
        camera = camera_of_file(request.camera, request.mask, settings.state_space)
    return Sessions(scene, settings, camera, request.limits)


@contextlib.contextmanager
def _listening(host: str, port: int) -> Iterator[socket.socket]:
    """A socket at an address, before anything takes time."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = found[0]
        listener = socket.create_server(address, family=family, backlog=128)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        where = f"port {port} of {quoted(host)}"
        raise OptionError(f"{where} cannot be listened at ({reason})") from error
    with listener:
        yield listener


def _server(app: object, limits: Limits) -> "uvicorn.Server":
    """The server, which writes no log of its own."""
    import uvicorn

    from pipelines.serve.connection import with_header_seconds

    class Server(uvicorn.Server):
        """uvicorn's, which leaves signals to who runs it."""

        @contextlib.contextmanager
        def capture_signals(self) -> Iterator[None]:
            yield

    return Server(
        uvicorn.Config(
            app,  # type: ignore[arg-type]
            loop="asyncio",
            http=with_header_seconds(limits.header_seconds),
            ws="none",
            lifespan="on",
            log_config=None,
            log_level="critical",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            # Of a header that has not come to its end; of the others ``admission`` says the same.
            h11_max_incomplete_event_size=MAX_HEADER_BYTES,
            timeout_graceful_shutdown=int(GRACE_SECONDS),
        )
    )


async def _run(
    server: "uvicorn.Server", listener: socket.socket, announce: Callable[[str], None]
) -> None:
    """Serves until a signal comes; a second one does not wait for answers."""

    def stop(number: int) -> None:
        _log.debug("%s: stopping", signal.Signals(number).name)
        server.force_exit = server.should_exit
        server.should_exit = True

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop, number)
    serving = asyncio.create_task(server.serve([listener]))
    while not server.started and not serving.done():
        await asyncio.sleep(0.01)
    if server.started:
        announce(_url(listener))
    await serving


def _url(listener: socket.socket) -> str:
    host, port = listener.getsockname()[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
