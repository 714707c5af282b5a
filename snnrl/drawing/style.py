"""How figures look: one colour for each robot everywhere, sizes that read on a phone and in print."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snnrl.intervals import student_half

# Okabe and Ito's palette, safe for the colour-blind
ROBOTS: Mapping[str, str] = {
    "random_walk": "#7f7f7f",
    "learning_disabled": "#000000",
    "learning": "#0072B2",
    "no_container_dopamine": "#E69F00",
    "container_dopamine_learning": "#009E73",
    "fixed_container_dopamine": "#D55E00",
    "benchmark": "#CC79A7",
    "positive_baseline": "#56B4E9",
    "no_burst_threshold": "#8C6D1F",
    "no_hunger": "#B8A200",
}
PUBLISHED: Mapping[str, Any] = {"color": "#333333", "linestyle": (0, (4, 3)), "linewidth": 1.0}
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
}


def figure(rows: int = 1, columns: int = 1, width: float = 6.4, height: float = 3.2, **options: Any) -> Any:
    """A figure in the house style and its axes, as `Figure.subplots` returns them; inches."""
    with mpl.rc_context(STYLE):
        drawn = Figure(figsize=(width, height))
        return drawn, drawn.subplots(rows, columns, **options)


def png(drawn: Figure, dpi: float | str = "figure") -> bytes:
    """A figure as a PNG file."""
    buffer = io.BytesIO()
    drawn.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def robot_name(robot: str) -> str:
    return robot.replace("_", " ")


def band(axis: Axes, time: np.ndarray, values: np.ndarray, colour: str, label: str, **options: Any) -> None:
    """Mean of [T, B] over trials with its 95 % interval; the area shows the standard deviation over trials."""
    mean, trials = values.mean(1), values.shape[1]
    if trials > 1:
        sd = values.std(1, ddof=1)
        for reach, alpha in ((sd, 0.10), (student_half(sd, trials), 0.30)):
            axis.fill_between(time, mean - reach, mean + reach, color=colour, alpha=alpha, linewidth=0)
    axis.plot(time, mean, color=colour, label=label, **options)


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
