"""How a run tells how far it is."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Progress:
    """One line about a run: on a terminal it is redrawn, in a log it is repeated at every tenth.

    Args:
        name: what the line begins with.
        trials: of the run.
        seconds: simulated, of each trial.
        wall: s of wall time that the run has taken before.
    """

    def __init__(self, name: str, trials: int, seconds: float, wall: float = 0.0) -> None:
        self.name, self.trials, self.seconds = name, trials, seconds
        self.shown = time.perf_counter()
        self.started = self.shown - wall
        self.tenth = 0
        self.redraws = sys.stderr.isatty()

    @property
    def wall(self) -> float:
        """s of wall time that the run has taken so far."""
        return time.perf_counter() - self.started

    @contextmanager
    def preparing(self) -> Iterator[None]:
        """What happens in this context is no part of the run's time."""
        began = time.perf_counter()
        yield
        self.started += time.perf_counter() - began

    def show(self, done: float, state: Callable[[], str]) -> None:
        """`done` simulated seconds of each trial; `state` says what they came to."""
        now = time.perf_counter()
        part = min(done / self.seconds, 1.0)
        due = now - self.shown > 0.2 or part == 1.0 if self.redraws else part * 10 >= self.tenth + 1
        if not due:
            return
        self.shown, self.tenth = now, int(part * 10)
        wall = now - self.started
        speed = self.trials * done / wall
        left = wall * (1.0 - part) / part
        line = (
            f"{self.name}  {part:4.0%}  {done:.0f} of {self.seconds:.0f} s  {state()}  "
            f"{speed / 1000.0:.2f} million trial-ms/s, {speed:,.0f} x real time  {left:.0f} s left"
        )
        self._print(line, "\r" if self.redraws and part < 1.0 else "\n")

    def say(self, line: str) -> None:
        """A line that stays."""
        self._print(f"{self.name}  {line}", "\n")

    def _print(self, line: str, end: str) -> None:
        print(f"{line:<{shutil.get_terminal_size().columns - 1}}" if self.redraws else line, end=end, file=sys.stderr)
