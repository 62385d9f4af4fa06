"""What a server takes from its clients at most, so that no client takes it from the others."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from pipelines.artifacts.arguments import check_fields, checked_number
from pipelines.dataset.images import MAX_PIXELS

MEGABYTE = 1024 * 1024
# What is no image is short.
MAX_JSON_BYTES = 64 * 1024
MAX_HEADER_BYTES = 32 * 1024
# Images of one session that may wait for the one before them.
MOST_WAITING = 4
# How many requests at once a rate allows, in seconds of it: images arrive in bursts.
BURST_SECONDS = 1.0


@dataclass(frozen=True)
class Limits:
    """What is refused.

    Attributes:
        megabytes: of a request's content, at most.
        megapixels: of an image, at most; its header tells, before anything is decoded.
        rate: images a second and session, at most.
        sessions: at the same time, at most.
        idle_seconds: after which a session that nobody asked anything is closed.
        header_seconds: within which a client has to send a request's header.
        content_seconds: within which it has to send the content.

    Raises:
        OptionError: a value out of range or of another type.
    """

    megabytes: float = 16.0
    megapixels: float = 25.0
    rate: float = 30.0
    sessions: int = 16
    idle_seconds: float = 600.0
    header_seconds: float = 10.0
    content_seconds: float = 30.0

    def __post_init__(self) -> None:
        check_fields(self)
        checked_number(self.megabytes, "the limit of a request's megabytes", 0.001, 1024.0)
        most = MAX_PIXELS / 1e6
        checked_number(self.megapixels, "the limit of an image's megapixels", 0.001, most)
        checked_number(self.rate, "the limit of images a second", 0.001, 1e6)
        checked_number(self.sessions, "the limit of sessions", 1, 1000, whole=True)
        checked_number(self.idle_seconds, "the seconds of an idle session", 0.1, 1e9)
        checked_number(self.header_seconds, "the seconds of a header", 0.1, 3600.0)
        checked_number(self.content_seconds, "the seconds of a content", 0.1, 3600.0)

    @property
    def content_bytes(self) -> int:
        """Of a request with an image, at most."""
        return int(self.megabytes * MEGABYTE)

    @property
    def pixels(self) -> int:
        """Of an image, at most."""
        return int(self.megapixels * 1e6)


class RateLimit:
    """A bucket of tokens: one an image, refilled at the rate, a second's worth at most.

    Args:
        rate: images a second.
        clock: seconds that never go back.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._clock = rate, clock
        # Of a rate below one a second, one image has to fit.
        self._most = max(1.0, rate * BURST_SECONDS)
        self._tokens, self._filled = self._most, clock()

    def take(self) -> float:
        """Takes a token, where there is one.

        Returns:
            0, or the seconds until there will be one.
        """
        now = self._clock()
        self._tokens = min(self._most, self._tokens + self._rate * (now - self._filled))
        self._filled = now
        if self._tokens < 1.0:
            return (1.0 - self._tokens) / self._rate
        self._tokens -= 1.0
        return 0.0
