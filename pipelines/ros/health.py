"""How the node is doing, for /diagnostics: rate, latency, status, confidence, and what is missing.

A fault is said once when it begins and once when it is over, not with every image.
"""

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

# DiagnosticStatus's levels.
OK, WARN, ERROR, STALE = range(4)
# Latencies of so many images are kept.
WINDOW = 200


@dataclass(frozen=True)
class Report:
    """What a DiagnosticStatus says: level, message, values by name."""

    level: int
    message: str
    values: dict[str, str]


class Health:
    """Counts images and their latency, and holds the fault that is on.

    Args:
        silence: seconds without an image after which the camera counts as silent.
        topic: of the images, for the message.
    """

    def __init__(self, silence: float, topic: str) -> None:
        self._silence, self._topic = silence, topic
        self._lock = threading.Lock()
        self._arrivals: deque[float] = deque(maxlen=WINDOW)
        self._latencies: deque[float] = deque(maxlen=WINDOW)
        self._begin: float | None = None
        self._received = self._given_up = self._localized = 0
        self._status, self._confidence = "waiting", 0.0
        self._faults: dict[str, str] = {}

    def start(self, now: float) -> None:
        """Images are awaited from now on (monotonic clock, seconds)."""
        with self._lock:
            self._begin = now
            self._arrivals.clear()
            self._status, self._faults = "waiting", {}

    def arrived(self, now: float, *, gave_up: bool) -> None:
        """An image has arrived; ``gave_up``: an older one was given up for it."""
        with self._lock:
            self._received += 1
            self._given_up += gave_up
            self._arrivals.append(now)

    def localized(self, latency: float, status: str, confidence: float) -> None:
        """An image has been localized, so many seconds after it arrived."""
        with self._lock:
            self._localized += 1
            self._latencies.append(latency)
            self._status, self._confidence = status, confidence

    def fault(self, kind: str, text: str) -> str | None:
        """Notes that something is wrong, or right again where ``text`` is empty.

        Args:
            kind: of the fault; of each kind one is on at a time.
            text: for people.

        Returns:
            A line to be logged: faults that begin, change their text or are over; else None.
        """
        with self._lock:
            before = self._faults.get(kind, "")
            if bool(text) == bool(before):
                if text:
                    self._faults[kind] = text
                return None
            if text:
                self._faults[kind] = text
                return text
            del self._faults[kind]
            return f"over: {before}"

    def check_silence(self, now: float) -> str | None:
        """Notes whether the camera is silent; a line to be logged, or None."""
        with self._lock:
            if self._begin is None:
                return None
            since = now - max(self._begin, self._arrivals[-1] if self._arrivals else self._begin)
        is_silent = since >= self._silence
        text = f"no image on {self._topic} for {self._silence:g} s" if is_silent else ""
        return self.fault("silence", text)

    def report(self, now: float) -> Report:
        """What is to be said now (monotonic clock, seconds)."""
        with self._lock:
            recent = [time for time in self._arrivals if now - time <= 2.0]
            latencies = 1000.0 * np.array(self._latencies)
            values = {
                "status": self._status,
                "confidence": f"{self._confidence:.3f}",
                "image rate (Hz)": f"{len(recent) / 2.0:.1f}",
                "images received": str(self._received),
                "images given up": str(self._given_up),
                "images localized": str(self._localized),
            }
            if len(latencies):
                values["latency median (ms)"] = f"{np.median(latencies):.1f}"
                values["latency p99 (ms)"] = f"{np.percentile(latencies, 99):.1f}"
            faults = list(self._faults.values())
            if faults:
                return Report(ERROR, "; ".join(faults), values)
            if self._status in ("lost", "global", "waiting"):
                texts = {"lost": "lost", "global": "searching", "waiting": "waiting for images"}
                return Report(WARN, texts[self._status], values)
            return Report(OK, self._status, values)
