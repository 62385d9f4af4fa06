"""A connection of a client, guarded against headers that come slowly or are none.

uvicorn waits for the rest of a header for ever, and answers a malformed one in plain text. The
content of a request is guarded where it is read (``admission``).
"""

import asyncio
import json
import logging

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

# Connections at the same time: most of the files that a process may have open by default.
MOST_CONNECTIONS = 500

_log = logging.getLogger(__name__)


class GuardedConnection(H11Protocol):
    """uvicorn's connection; ``with_header_seconds`` makes a class of one's own limit."""

    header_seconds = 10.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Takes a new connection, unless there are too many."""
        self._header_timer: asyncio.TimerHandle | None = None
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            self._refuse(503, "too many connections")
            return
        self._watch_header()

    def data_received(self, data: bytes) -> None:
        """Takes bytes that came."""
        super().data_received(data)
        self._watch_header()

    def on_response_complete(self) -> None:
        """Goes on with the next request, whose header may have come in part already."""
        super().on_response_complete()
        self._watch_header()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forgets the connection."""
        self._unwatch_header()
        super().connection_lost(exc)

    def timeout_keep_alive_handler(self) -> None:
        """Ends a connection on which nothing is asked any more."""
        self._unwatch_header()
        super().timeout_keep_alive_handler()

    def send_400_response(self, msg: str) -> None:
        """Answers what is no HTTP."""
        self._refuse(400, "this is not a request in HTTP, or its header is too long")

    def _is_awaited(self) -> bool:
        """Whether a header is to come, or the rest of a content that nobody reads any more."""
        is_answered = self.conn.our_state is h11.DONE and self.conn.their_state is h11.SEND_BODY
        return self.conn.their_state is h11.IDLE or is_answered

    def _watch_header(self) -> None:
        """Sets the clock while a header is awaited, and not anew by each byte of it."""
        if not self._is_awaited() or self.transport.is_closing():
            self._unwatch_header()
        elif self._header_timer is None:
            self._header_timer = self.loop.call_later(self.header_seconds, self._header_is_late)

    def _unwatch_header(self) -> None:
        if self._header_timer is not None:
            self._header_timer.cancel()
            self._header_timer = None

    def _header_is_late(self) -> None:
        self._header_timer = None
        if not self._is_awaited() or self.transport.is_closing():
            return
        if self.conn.their_state is h11.IDLE:
            self._refuse(408, f"the header did not come within {self.header_seconds:g} s")
        else:
            self.transport.close()

    def _refuse(self, status: int, reason: str) -> None:
        """Answers with an error, past the application, and closes the connection."""
        self._unwatch_header()
        client = self.client[0] if self.client else "unknown"
        _log.debug("refused a connection: %d %s %s", status, reason, client)
        content = json.dumps({"error": reason}).encode()
        # Past h11 as well, which in some states would send nothing.
        self.transport.write(
            b"HTTP/1.1 %d %s\r\nContent-Type: application/json\r\nContent-Length: %d\r\n"
            b"Connection: close\r\n\r\n%b" % (status, _PHRASES[status], len(content), content)
        )
        self.transport.close()


_PHRASES = {400: b"Bad Request", 408: b"Request Timeout", 503: b"Service Unavailable"}


def with_header_seconds(seconds: float) -> type[GuardedConnection]:
    """The class of connections whose headers have to come within so many seconds."""
    return type("Connection", (GuardedConnection,), {"header_seconds": seconds})
