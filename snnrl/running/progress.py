"""How a run tells how far it is."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

LINE = "{desc}  {percentage:3.0f}% {bar} {n:.0f} of {total:.0f} s{postfix}, {remaining} left"
APART = 0.2  # s of wall time between two redraws


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
        self.bar: tqdm | None = None

    @property
    def wall(self) -> float:
        """s of wall time that the run has taken so far."""
        return time.perf_counter() - self.started

    @contextmanager
    def preparing(self) -> Iterator[Callable[[], None]]:
        """What happens in this context is no part of the run's time; what it gives is to be called before compiling."""
        began, compiles = time.perf_counter(), []

        def compiling() -> None:
            compiles.append(True)
            self.say("compiling, once")

        yield compiling
        took = time.perf_counter() - began
        self.started += took
        if compiles:
            self.say(f"compiled in {took:.1f} s")

    @contextmanager
    def running(self, done: float) -> Iterator[None]:
        """Time is advanced in this context, from so many simulated seconds on."""
        if sys.stderr.isatty():
            self.bar = tqdm(
                desc=self.name, total=self.seconds, initial=done, bar_format=LINE, dynamic_ncols=True, file=sys.stderr
            )
        try:
            yield
        finally:
            if self.bar is not None:
                self.bar.close()

    def show(self, done: float, state: Callable[[], str]) -> None:
        """`done` simulated seconds of each trial; `state` says what they came to."""
        now, part = time.perf_counter(), min(done / self.seconds, 1.0)
        due = now - self.shown > APART or part == 1.0 if self.bar else part * 10 >= self.tenth + 1
        if not due:
            return
        self.shown, self.tenth = now, int(part * 10)
        wall = now - self.started
        speed = self.trials * done / wall
        told = f"{state()}  {speed / 1000.0:.2f} million trial-ms/s, {speed:,.0f} x real time"
        if self.bar is None:
            left = wall * (1.0 - part) / part
            self.say(f"{part:4.0%}  {done:.0f} of {self.seconds:.0f} s  {told}  {left:.0f} s left")
        else:
            self.bar.n = part * self.seconds
            self.bar.set_postfix_str(told)

    def say(self, line: str) -> None:
        """A line that stays."""
        tqdm.write(f"{self.name}  {line}", file=sys.stderr)
