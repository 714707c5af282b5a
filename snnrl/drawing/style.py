"""How figures look: what axes are called, legends, areas, sizes that read on a phone and in print; and their files."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from snnrl.drawing import palette
from snnrl.files import write
from snnrl.intervals import student_half

PUBLISHED: Mapping[str, Any] = {"color": palette.PUBLISHED, "linestyle": (0, (4, 3)), "linewidth": 1.0}
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.5,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "snnrl",  # the same figure is the same file
}
TIME, RATE, FIRING = "Time (s)", "Collection rate (items/s)", "Firing rate (Hz)"
X, Y = "Position x (cm)", "Position y (cm)"
WEIGHT, MEAN_WEIGHT = "Weight (mV)", "Mean weight (mV)"
ELIGIBILITY, MEAN_ELIGIBILITY = "Eligibility (mV/(µM ms))", "Mean eligibility (mV/(µM ms))"
LEVEL = "Dopamine (µM)"
MEAN, INTERVAL, SPREAD, OTHERS = "mean over trials", "95 % interval of the mean", "SD over trials", "mean of each other"
AREAS = {SPREAD: 0.10, INTERVAL: 0.30}  # opacities
NEUTRAL: Mapping[str, Artist] = {  # in a legend, what each has in its own colour
    MEAN: Line2D([], [], color=palette.OTHER),
    INTERVAL: Patch(color=palette.OTHER, alpha=sum(AREAS.values()), linewidth=0),
    SPREAD: Patch(color=palette.OTHER, alpha=AREAS[SPREAD] + 0.05, linewidth=0),
}


P = ParamSpec("P")
R = TypeVar("R")


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """A function that draws, in the house style: of what it makes, and of what it puts on axes that are there."""

    @functools.wraps(draw)
    def within(*arguments: P.args, **options: P.kwargs) -> R:
        with mpl.rc_context(STYLE):
            return draw(*arguments, **options)

    return within


@styled
def figure(rows: int = 1, columns: int = 1, width: float = 6.4, height: float = 3.2, **options: Any) -> Any:
    """A figure in the house style and its axes, as `Figure.subplots` returns them; inches."""
    drawn = Figure(figsize=(width, height))
    return drawn, drawn.subplots(rows, columns, **options)


def encoded(drawn: Figure, dpi: float = 150) -> dict[str, bytes]:
    """A figure as files, by how their names end: a bitmap and a vector graphic, the same for the same figure."""
    return {f".{kind}": _encode(drawn, kind, dpi) for kind in ("png", "svg")}


@styled
def _encode(drawn: Figure, kind: str, dpi: float) -> bytes:
    buffer = io.BytesIO()
    drawn.savefig(buffer, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
    return buffer.getvalue()


def save(drawn: Figure, path: Path, dpi: float = 150) -> None:
    """Write PATH.png and PATH.svg."""
    for kind, content in encoded(drawn, dpi).items():
        write(path.with_name(path.name + kind), content)


def spoken(name: str) -> str:
    """A name of the configuration as a figure has it."""
    return name.replace("_", " ")


def quantity(name: str, unit: str) -> str:
    """What an axis is called: Quantity (unit)."""
    words = " ".join("τ" if word == "tau" else word for word in spoken(name).split())
    words = words.replace("τ plus", "τ₊").replace("τ minus", "τ₋")
    return words[:1].upper() + words[1:] + (f" ({unit.replace('uM', 'µM')})" if unit else "")


def band(axis: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str, **options: Any) -> None:
    """Mean of [T, B] over trials with its 95 % interval; the paler area is the standard deviation over trials."""
    mean, trials = values.mean(1), values.shape[1]
    if trials > 1:
        sd = values.std(1, ddof=1)
        for name, reach in ((SPREAD, sd), (INTERVAL, student_half(sd, trials))):
            area = axis.fill_between(time, mean - reach, mean + reach, color=colour, alpha=AREAS[name], linewidth=0)
            area.set_label(name)
    axis.plot(time, mean, color=colour, label=label, **options)


def multiples(axes: Iterable[Axes], courses: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """A panel for each robot's time [T] and values [T, B]: its own with its areas, the others' means pale behind it."""
    for axis, name in zip(axes, courses, strict=False):
        for time, values in (course for other, course in courses.items() if other != name):
            axis.plot(time, values.mean(1), color=palette.PALE, linewidth=0.8, label=OTHERS)
        band(axis, *courses[name], palette.of_robot(name), MEAN)
        axis.set_title(spoken(name), color=palette.of_robot(name), fontsize=7)


def legend(of: Axes | Figure, **options: Any) -> None:
    """One entry for each mark of some axes, or of all of a figure; areas are told of last."""
    axes = of.axes if isinstance(of, Figure) else [of]
    found: dict[str, Artist] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            found.setdefault(label, NEUTRAL.get(label, handle))
    last = [label for label in (INTERVAL, SPREAD, OTHERS) if label in found]
    labels = [label for label in found if label not in last] + last
    of.legend([found[label] for label in labels], labels, **options)


def above(columns: int = 3) -> dict[str, Any]:
    """Where a legend is that would cover what it explains: above the axes."""
    return {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.0, "ncols": columns}


def mark(axis: Axes, value: float, text: str, vertical: bool = False) -> None:
    """A known value as a dashed line with its meaning at its end, if the axis reaches that far."""
    low, high = axis.get_xlim() if vertical else axis.get_ylim()
    if not low <= value <= high:
        return
    if vertical:
        axis.axvline(value, **PUBLISHED)
        where = {"xy": (value, 1.0), "xycoords": ("data", "axes fraction"), "xytext": (3, -2), "va": "top"}
    else:
        axis.axhline(value, **PUBLISHED)
        where = {"xy": (1.0, value), "xycoords": ("axes fraction", "data"), "xytext": (-2, 2), "ha": "right"}
    axis.annotate(text, textcoords="offset points", fontsize=7, color=PUBLISHED["color"], **where)  # type: ignore[arg-type]
