"""The page of an experiment: its table between two marks in the text, its figure beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from snnrl.drawing.style import save
from snnrl.errors import ConfigError
from snnrl.files import write

DPI = 110
BEGIN, END = "<!-- begin table -->\n", "<!-- end table -->\n"


@dataclass(frozen=True)
class Page:
    """What an experiment has come to."""

    table: str
    figure: Figure

    def save(self, folder: Path) -> None:
        """Write table.md, figure.png and figure.svg."""
        write(folder / "table.md", self.table)
        save(self.figure, folder / "figure", DPI)

    def put_into(self, path: Path) -> None:
        """Replace the table and the figure in a page; raises as `around_table` does."""
        before, after = around_table(path)
        drawn = path.with_suffix(".png")
        save(self.figure, path.with_suffix(""), DPI)
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


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
