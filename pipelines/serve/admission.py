"""What a request has to pass before anything looks at what it wants, and its line in the log.

A browser sends requests to this machine on behalf of any page that is open in it. Three checks keep
such pages out where no token does: the name by which the server was called has to be one of this
machine (else an attacker's name may have been pointed here: DNS rebinding); a request that says
which page it comes from has to come from the server's own; and contents have to be of a type for
which a browser asks permission beforehand, which is never given.
"""

import asyncio
import ipaddress
import logging
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse

from pipelines.artifacts.errors import quoted, reason_of
from pipelines.serve.limits import MAX_HEADER_BYTES, MAX_JSON_BYTES, Limits
from pipelines.serve.tokens import Tokens

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[MutableMapping[str, Any], Receive, Send], Awaitable[None]]

# What everybody may see: descriptions of the interface, and whether the server is alive.
OPEN_PATHS = ("/docs", "/openapi.json", "/health")
IMAGES = "/images"
JSON_TYPES = ("application/json",)
IMAGE_TYPES = ("image/jpeg", "image/png", "application/octet-stream")
# Of a content that is too long so much is still read, and for so long: a client that is sending
# hears the answer only after that.
READ_ON_BYTES, READ_ON_SECONDS = 64 * 1024 * 1024, 5.0
DEFECT = "internal error; the server's log says more"
# Of answers: nothing else than what they say they are, in no frame, kept by nobody.
ANSWER_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"cache-control", b"no-store"),
)

_log = logging.getLogger(__name__)


class Admission:
    """Stands before the application, as an application of ASGI.

    Args:
        app: what admitted requests go to; their owner is ``scope["state"]["owner"]``.
        tokens: of which a request has to hold one; none: anybody may ask, by names of this machine.
        limits: of contents.
        host: address that the server listens at.
    """

    def __init__(self, app: App, tokens: Tokens, limits: Limits, host: str) -> None:
        self._app, self._tokens, self._limits, self._host = app, tokens, limits, host

    async def __call__(self, scope: MutableMapping[str, Any], receive: Receive, send: Send) -> None:
        """Answers a request, whatever happens."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start, status = time.perf_counter(), 0

        async def answer(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message.get("headers", ()), *ANSWER_HEADERS]
            await send(message)

        headers = Headers(scope=scope)
        content = Content(receive, self._limit(scope), self._limits.content_seconds)
        try:
            scope.setdefault("state", {})["owner"] = self._admitted(headers, scope)
            await content.check_announced(headers)
            await self._app(scope, content, answer)
        except HTTPException as error:
            await refusal(error)(scope, content, answer)
        except Exception as error:  # noqa: BLE001
            _log.error("internal error, please report it: %s", _words(error))
            _log.debug("where it happened:", exc_info=True)
            if not status:
                await refusal(HTTPException(500, DEFECT))(scope, content, answer)
        milliseconds = 1000.0 * (time.perf_counter() - start)
        client = scope.get("client") or ("unknown", 0)
        _log.debug(
            "%s %s %d %.1f ms %s",
            reason_of(scope["method"]),
            reason_of(scope["path"]),
            status,
            milliseconds,
            client[0],
        )

    def _limit(self, scope: MutableMapping[str, Any]) -> int:
        takes_image = scope["path"].endswith(IMAGES)
        return self._limits.content_bytes if takes_image else MAX_JSON_BYTES

    def _admitted(self, headers: Headers, scope: MutableMapping[str, Any]) -> str:
        """The owner of a request; raises HTTPException where it is refused."""
        sent = [*headers.raw, (scope.get("raw_path") or b"", scope["query_string"])]
        if sum(len(name) + len(value) for name, value in sent) > MAX_HEADER_BYTES:
            raise HTTPException(
                431, f"the header is longer than {MAX_HEADER_BYTES} bytes", {"Connection": "close"}
            )
        called, origin = headers.get("host", ""), headers.get("origin")
        # A token is nothing that a browser adds by itself: who sends one is asked nothing else.
        if not len(self._tokens):
            if not self._is_own_name(called):
                raise HTTPException(
                    421, f"this server is not called {quoted(called)}; ask for localhost"
                )
            if origin is not None and _authority(origin) != called.lower():
                raise HTTPException(403, "pages of other servers may not ask this one")
        if headers.get("content-encoding", "identity").lower() != "identity":
            raise HTTPException(415, "contents are taken as they are, not compressed")
        path = scope["path"]
        known = IMAGE_TYPES if path.endswith(IMAGES) else JSON_TYPES
        kind = headers.get("content-type", "").partition(";")[0].strip().lower()
        if scope["method"] == "POST" and kind not in known:
            raise HTTPException(415, f"the content's type has to be {' or '.join(known)}")
        if any(path == free or path.startswith(f"{free}/") for free in OPEN_PATHS):
            return ""
        owner = self._tokens.owner_of(headers.get("authorization", "").encode("latin-1"))
        if owner is None:
            raise HTTPException(
                401,
                "a token is needed: Authorization: Bearer TOKEN",
                {"WWW-Authenticate": "Bearer"},
            )
        return owner

    def _is_own_name(self, called: str) -> bool:
        """Whether a Host header names this machine, with or without a port (of a tunnel, say)."""
        try:
            name = urlsplit(f"//{called}").hostname or ""
        except ValueError:
            return False
        if name in ("localhost", self._host):
            return True
        try:
            return ipaddress.ip_address(name).is_loopback
        except ValueError:
            return False


class Content:
    """Receives a request's content, up to a length and a time.

    Args:
        receive: ASGI's.
        limit: bytes that are taken.
        seconds: from now on until all of it has to be there.
    """

    def __init__(self, receive: Receive, limit: int, seconds: float) -> None:
        self._receive, self._limit = receive, limit
        self._end = asyncio.get_running_loop().time() + seconds
        self._seconds = seconds
        self._taken, self._is_complete = 0, False

    async def __call__(self) -> Message:
        """The next piece.

        Raises:
            HTTPException: too much, or too slowly; the connection is then closed.
        """
        if self._is_complete:
            return await self._receive()
        message = await self._next(self._end)
        if self._taken > self._limit:
            await self._read_on()
            raise self._too_long()
        return message

    async def check_announced(self, headers: Headers) -> None:
        """Refuses a content of which the header says that it is too long.

        Raises:
            HTTPException: it is.
        """
        length = headers.get("content-length", "0")
        if len(length) < 20 and length.isdecimal() and int(length) <= self._limit:
            return
        # Who asks beforehand has not begun to send.
        if headers.get("expect", "").lower() != "100-continue":
            await self._read_on()
        raise self._too_long()

    def _too_long(self) -> HTTPException:
        text = f"the content is longer than {self._limit} bytes"
        return HTTPException(413, text, {"Connection": "close"})

    async def _next(self, end: float) -> Message:
        try:
            async with asyncio.timeout_at(end):
                message = await self._receive()
        except TimeoutError as error:
            self._is_complete = True
            raise HTTPException(
                408,
                f"the content did not come within {self._seconds:g} s",
                {"Connection": "close"},
            ) from error
        self._taken += len(message.get("body", b""))
        self._is_complete = not message.get("more_body", False)
        return message

    async def _read_on(self) -> None:
        """Drops the rest, within limits: who is still sending does not hear an answer."""
        end = min(self._end, asyncio.get_running_loop().time() + READ_ON_SECONDS)
        while not self._is_complete and self._taken < self._limit + READ_ON_BYTES:
            await self._next(end)
        self._is_complete = True


def refusal(error: HTTPException) -> JSONResponse:
    """An error as an answer: one line of JSON."""
    headers = dict(error.headers or {})
    return JSONResponse({"error": reason_of(error.detail)}, error.status_code, headers)


def _authority(origin: str) -> str:
    """The host and port of an Origin header; empty where there is none."""
    try:
        return urlsplit(origin).netloc.lower()
    except ValueError:
        return ""


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {reason_of(error)}"
