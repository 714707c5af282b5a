"""What a logger is: whoever keeps or shows a run while it goes on, besides the run's folder. Steps are simulated s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

BINS = 60


@dataclass(frozen=True)
class Chart:
    """Scalars that belong in one picture.

    Attributes:
        title: with the unit.
        tags: of the scalars.
        band: whether they are a line and the lower and the upper edge of a band around it.
    """

    title: str
    tags: tuple[str, ...]
    band: bool = False


@dataclass(frozen=True)
class About:
    """What loggers are told of a run before all else.

    Attributes:
        folder: of the run.
        name: of the experiment.
        choices: its hyperparameters, by key.
        metrics: tags of the scalars that are what it has come to.
        charts: by the titles of their categories.
    """

    folder: Path
    name: str = ""
    choices: Mapping[str, str | float] = field(default_factory=dict)
    metrics: Sequence[str] = ()
    charts: Mapping[str, Sequence[Chart]] = field(default_factory=dict)


@dataclass(frozen=True)
class Histogram:
    """Finite `values`, of which the bins are between `least` and `most`, or beyond where there are such."""

    values: np.ndarray
    least: float
    most: float

    def bins(self) -> tuple[np.ndarray, np.ndarray]:
        """Counts [60] and edges [61]."""
        return np.histogram(self.values, BINS, (min(self.least, self.values.min()), max(self.most, self.values.max())))


class Logger(Protocol):
    """Told of a run as it goes on. What it raises ends the run, which can be gone on with."""

    def begin(self, about: About, saved: int | str | None) -> None:
        """Before all else.

        Args:
            saved: what `flush` gave at the checkpoint from which the run goes on; whatever this logger was told after
                that, it will be told again. None at the start of a run.
        """

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        """All numbers of one moment, by their tags."""

    def histograms(self, values: Mapping[str, Histogram], step: int) -> None:
        """Weights of all trials (mV), by their tags."""

    def figure(self, tag: str, pixels: np.ndarray, step: int) -> None:
        """A picture, uint8 [height, width, 3]."""

    def text(self, tag: str, text: str, step: int) -> None:
        """A line about something that has happened."""

    def flush(self) -> int | str:
        """Keep for good all that it was told; what `begin` must know to go on from here."""

    def end(self) -> None:
        """The run is complete; in its folder all but summary.json is, too."""
