"""When things are due in a run: all that happens every so often, in control ticks from its start."""

from __future__ import annotations

import math
from dataclasses import dataclass

from snnrl.recording.film import spacing
from snnrl.schema import Config

NEVER = 1 << 60
# What loggers get of a run at most, and one more for each so many trial-seconds: of runs that are over in seconds
# writing all of it would take longer than simulating
POINTS, SECONDS_A_POINT = 60, 1000.0
HISTOGRAMS, SECONDS_A_HISTOGRAM = 4, 10_000.0


def ticks_of(seconds: float | None, tick: int) -> int:
    """Whole ticks (ms each) of an interval, at least one; 0 for none."""
    return max(1, round(1000 * seconds / tick)) if seconds else 0


@dataclass(frozen=True)
class Every:
    """Every so many `ticks` from `first` on; never if that is 0."""

    ticks: int
    first: int = 0

    def left(self, done: int) -> int:
        """Ticks until it is due next."""
        if not self.ticks:
            return NEVER
        return self.first - done if done < self.first else self.ticks - (done - self.first) % self.ticks

    def due(self, done: int) -> bool:
        return self.ticks > 0 and done >= self.first and (done - self.first) % self.ticks == 0


@dataclass(frozen=True)
class Due:
    """What is due after a tick: a point of the path, a sample, its scalars, histograms, a picture, a checkpoint."""

    point: bool
    sample: bool
    scalars: bool
    histograms: bool
    picture: bool
    checkpoint: bool


class Schedule:
    """What is due when, from the intervals of a configuration.

    At the end of a run there is a sample, which is shown, and, where there are any, histograms and a picture. Before
    each picture some ticks are filmed: who fires, and every so often where the robot is.

    Args:
        config: of the run.
        tick: ms.
        shown: whether there are histograms and pictures.

    Attributes:
        end: the last tick.
    """

    def __init__(self, config: Config, tick: int, shown: bool) -> None:
        record = config.record
        self.end = ticks_of(config.seconds, tick)
        self.samples = Every(ticks_of(record.every, tick), round(1000 * record.start / tick))
        self.histograms, self.pictures = (
            Every(ticks_of(seconds, tick) if shown else 0) for seconds in (record.histograms, record.pictures)
        )
        work = config.trials * config.seconds
        self.scalars = self._sparser(self.samples, POINTS + work / SECONDS_A_POINT)
        self.histograms = self._sparser(self.histograms, HISTOGRAMS + work / SECONDS_A_HISTOGRAM)
        self.checkpoints = Every(ticks_of(config.checkpoint.every, tick))
        self._step, points = spacing(tick)
        self._stretch = self._step * points

    def _sparser(self, every: Every, most: float) -> Every:
        """Every n-th of what is due, the first n so large that there are at most so many."""
        if not every.ticks:
            return every
        first = every.first or every.ticks
        due = (self.end - first) // every.ticks + 1
        apart = max(1, math.ceil(due / most))
        return Every(apart * every.ticks, first + (apart - 1) * every.ticks)

    def left(self, done: int) -> int:
        """How many ticks there are after `done` until the next thing is due, or filming begins."""
        intervals = (self.samples, self.histograms, self.checkpoints)
        return min(self.end - done, self._unfilmed(done), *(interval.left(done) for interval in intervals))

    def _unfilmed(self, done: int) -> int:
        """Ticks until filming begins or, while it goes on, until the next point of the path."""
        picture = self._picture(done)
        return picture - self._stretch if picture > self._stretch else picture % self._step or self._step

    def _picture(self, done: int) -> int:
        """Ticks until the next picture."""
        return min(self.pictures.left(done), self.end - done) if self.pictures.ticks else NEVER

    def filmed(self, done: int) -> bool:
        """Whether the ticks after `done`, as many as are `left`, are filmed."""
        return self._picture(done) <= self._stretch

    def due(self, done: int) -> Due:
        """What is due after `done` ticks, at least one."""
        at_end = done == self.end
        picture = self.pictures.due(done) or (at_end and self.pictures.ticks > 0)
        return Due(
            point=self.filmed(done - 1) and (picture or self._picture(done) % self._step == 0),
            sample=self.samples.due(done) or at_end,
            scalars=self.scalars.due(done) or at_end,
            histograms=self.histograms.due(done) or (at_end and self.histograms.ticks > 0),
            picture=picture,
            checkpoint=self.checkpoints.due(done),
        )
