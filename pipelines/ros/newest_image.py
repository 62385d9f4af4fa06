"""A queue of one image: what is late is worth less than what is new.

A camera sends as it likes, the filter takes as long as it takes. Where an image waits while the
next arrives, the older one is given up, and localization never falls behind.
"""

import threading
import time
from typing import Generic, TypeVar

T = TypeVar("T")


class NewestQueue(Generic[T]):
    """Holds the newest item; filled by one thread, emptied by another."""

    def __init__(self) -> None:
        self._item: tuple[T, float] | None = None
        self._changed = threading.Condition()
        self._is_closed = False

    @property
    def is_closed(self) -> bool:
        """Whether nobody is to wait any more."""
        return self._is_closed

    def put(self, item: T) -> T | None:
        """Makes an item the newest; returns the one that was given up for it, if any."""
        with self._changed:
            given_up = None if self._item is None else self._item[0]
            self._item = (item, time.monotonic())
            self._changed.notify()
        return given_up

    def get(self, seconds: float) -> tuple[T, float] | None:
        """The newest item, once there is one, and when it arrived (monotonic clock, seconds).

        Args:
            seconds: to wait at most.

        Returns:
            None where nothing came, or the queue was closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None or self._is_closed, seconds)
            if self._is_closed:
                return None
            item, self._item = self._item, None
            return item

    def clear(self) -> None:
        """Gives up what waits."""
        with self._changed:
            self._item = None

    def close(self) -> None:
        """Wakes whoever waits, for the last time."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
