"""The page of an experiment: its table between two marks in the text, its figure beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snnrl.agents import baselines
from snnrl.drawing.style import ROBOTS, png
from snnrl.errors import ConfigError
from snnrl.files import write
from snnrl.intervals import student_half

COLOURS = {
    **ROBOTS,
    **baselines.COLOURS,
    "learning": baselines.COLOURS[baselines.SPIKING],
    "no_pain": ROBOTS["no_hunger"],
    "no_moving_dopamine": ROBOTS["no_container_dopamine"],
    "fixed_dopamine": ROBOTS["fixed_container_dopamine"],
    "phasic": ROBOTS["container_dopamine_learning"],
    "no_rhythm": ROBOTS["positive_baseline"],
    "winner": ROBOTS["fixed_container_dopamine"],
    "no_rivalry": ROBOTS["no_container_dopamine"],
    "background": ROBOTS["benchmark"],
    "in_network": ROBOTS["learning"],
}
BEGIN, END = "<!-- begin table -->\n", "<!-- end table -->\n"


@dataclass(frozen=True)
class Page:
    """What an experiment has come to."""

    table: str
    figure: Figure

    def save(self, folder: Path) -> None:
        """Write table.md and figure.png."""
        write(folder / "table.md", self.table)
        write(folder / "figure.png", png(self.figure, 110))

    def put_into(self, path: Path) -> None:
        """Replace the table and the figure in a page; raises as `around_table` does."""
        before, after = around_table(path)
        drawn = path.with_suffix(".png")
        write(drawn, png(self.figure, 110))
        write(path, f"{before}{BEGIN}![What is in the table, over time]({drawn.name})\n\n{self.table}{END}{after}")


def around_table(path: Path) -> tuple[str, str]:
    """A page's text before its table, and behind it.

    Raises:
        ConfigError: it has no place for a table.
        OSError: it cannot be read.
    """
    before, begin, rest = path.read_text().partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ConfigError("--page", path, f"must have the lines {BEGIN.strip()} and {END.strip()}")
    return before, after


def draw(axis: Axes, agent: str, time: np.ndarray, values: np.ndarray) -> None:
    """Mean of [T, B] over trials, in the agent's colour, with its interval."""
    mean, trials = values.mean(1), values.shape[1]
    axis.plot(time, mean, color=COLOURS[agent], label=agent.replace("_", " "))
    if trials > 1:
        half = student_half(values.std(1, ddof=1), trials)
        axis.fill_between(time, mean - half, mean + half, color=COLOURS[agent], alpha=0.2, linewidth=0)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
