"""How a run is told to stop: by a signal, noticed between two parts of the run that take little time."""

from __future__ import annotations

import signal
import threading
import time
from types import FrameType

SLICE = 0.5  # s of wall time between two looks for a signal


class Interrupted(Exception):
    """The run was told to stop by a signal, and has saved its state.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int, message: str) -> None:
        super().__init__(number, message)
        self.number, self.message = number, message

    def __str__(self) -> str:
        return self.message


class Signals:
    """Remembers SIGINT or SIGTERM while the context lasts; a second one has its usual effect."""

    received: signal.Signals | None = None

    def __enter__(self) -> Signals:
        self._usual = {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._usual[number] = signal.signal(number, self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        for number, usual in self._usual.items():
            signal.signal(number, usual)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        self.received = signal.Signals(number)
        self.__exit__()


class Pace:
    """How many ticks to run at once, so that they take about SLICE s; it measures what is run in its context."""

    def __init__(self) -> None:
        self.ticks = 1

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        took = time.perf_counter() - self._began
        self.ticks = self.ticks * 2 if took < SLICE else max(1, self.ticks // 2)
