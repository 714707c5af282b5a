"""What was fitted and how: the calibration's record, and the grid over the parameters of STDP."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from snnrl.drawing.palette import OTHER
from snnrl.drawing.style import figure
from snnrl.recording.runs import Run
from snnrl.schema import PlasticityConfig
from snnrl.thesis.loss import FARTHEST
from snnrl.thesis.verdicts import p_greater

CALIBRATION = Path(__file__).with_name("calibration.json")  # written by python -m snnrl.calibrate --record
FORMER_UNIT = "standard errors"  # of a record that does not say its unit: of the difference, our spread included
PLANES = (("potentiation", "depression"), ("tau_plus", "tau_minus"))
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # on the values in conf/


def calibration() -> dict[str, Any] | None:
    """The record of the fit that conf/ holds, `unit` that of its losses and distances; None before there is one."""
    return {"unit": FORMER_UNIT, **json.loads(CALIBRATION.read_text())} if CALIBRATION.exists() else None


def point_name(values: Mapping[str, float]) -> str:
    """Of a run of the grid."""
    return "stdp_search/" + ",".join(f"{key}={value:g}" for key, value in values.items())


def grid_points(centre: PlasticityConfig, factors: Sequence[float] = FACTORS) -> list[dict[str, float]]:
    """Every point of both planes."""
    return [
        {x: float(f"{a * getattr(centre, x):.6g}"), y: float(f"{b * getattr(centre, y):.6g}")}
        for x, y in PLANES
        for a in factors
        for b in factors
    ]


def point_of(name: str) -> dict[str, float]:
    """The values of a run of the grid, from its name."""
    return {key: float(value) for key, _, value in (part.partition("=") for part in name.partition("/")[2].split(","))}


def describe(name: str) -> str:
    """A point in words."""
    return ", ".join(f"{key}={value:g}" for key, value in point_of(name).items())


def scores(runs: Mapping[str, Run]) -> dict[str, np.ndarray]:
    """Food of each trial, by the names of the grid's runs."""
    return {name: run.trials["food"] for name, run in runs.items() if name.startswith("stdp_search/")}


def best_region(found: Mapping[str, np.ndarray]) -> tuple[str, list[str]]:
    """The point with the most food, and all that Welch's one-sided test (5 %) does not tell from it."""
    best = max(found, key=lambda name: found[name].mean())
    region = [name for name, values in found.items() if name == best or p_greater(found[best], values) > 0.05]
    return best, region


def heat_maps(runs: Mapping[str, Run]) -> Figure:
    """Mean score over both planes of the grid; points that are not worse than the best are dotted."""
    found = scores(runs)
    _, region = best_region(found)
    drawn, axes = figure(1, 2, width=7.2, height=3.3)
    means = [values.mean() for values in found.values()]
    units = {"potentiation": "mV/(uM ms)", "depression": "mV/(uM ms)", "tau_plus": "ms", "tau_minus": "ms"}
    for axis, (x, y) in zip(axes, PLANES, strict=True):
        points = [(point_of(name), name) for name in found if set(point_of(name)) == {x, y}]
        across, up = (sorted({point[key] for point, _ in points}) for key in (x, y))
        score = np.full((len(up), len(across)), np.nan)
        for point, name in points:
            row, column = up.index(point[y]), across.index(point[x])
            score[row, column] = found[name].mean()
            if name in region:
                axis.plot(column, row + 0.3, ".", color="white", ms=4)
        image = axis.imshow(score, origin="lower", cmap="viridis", vmin=min(means), vmax=max(means), aspect="auto")
        for (row, column), value in np.ndenumerate(score):
            dark = value < 0.5 * (min(means) + max(means))
            axis.text(
                column, row, f"{value:.0f}", ha="center", va="center", fontsize=7, color="white" if dark else "black"
            )
        axis.grid(False)
        axis.set_xticks(range(len(across)), [f"{value:g}" for value in across])
        axis.set_yticks(range(len(up)), [f"{value:g}" for value in up])
        axis.set(xlabel=f"{x} ({units[x]})", ylabel=f"{y} ({units[y]})")
    drawn.colorbar(image, ax=axes, label="items in a trial, mean")
    return drawn


def history(_: Mapping[str, Run]) -> Figure | None:
    """Every point of the calibration, and the best so far."""
    record = calibration()
    if record is None:
        return None
    losses = [point["loss"] for point in record["history"]]
    drawn, axis = figure(height=2.6)
    axis.plot(losses, ".", color=OTHER, label="a point")
    axis.step(range(len(losses)), np.minimum.accumulate(losses), where="post", color="#0072B2", label="best so far")
    axis.set(xlabel="point of the study", ylabel=f"RMS distance ({record['unit']})", ylim=(0, None))
    axis.legend(loc="upper right")
    return drawn


def sensitivity(_: Mapping[str, Run]) -> Figure | None:
    """How each cell moves when one value is changed."""
    record = calibration() or {}
    points = record.get("sensitivity", [])
    changed = [point for point in points if point["change"][0]]
    if not changed:
        return None
    base = next(point for point in points if not point["change"][0])
    cells = sorted(base["distances"])
    shift = np.array([[p["distances"].get(c, np.nan) - base["distances"][c] for p in changed] for c in cells])
    drawn, axis = figure(width=7.2, height=0.27 * len(cells) + 1.8)
    image = axis.imshow(shift, cmap="PuOr", vmin=-FARTHEST, vmax=FARTHEST, aspect="auto")
    for (row, column), value in np.ndenumerate(shift):
        if abs(value) >= 0.05:
            colour = "white" if abs(value) > 0.6 * FARTHEST else "black"
            axis.text(column, row, f"{value:+.1f}", ha="center", va="center", fontsize=6, color=colour)
    names = [f"{'.'.join(point['change'][0].split('.')[-2:])}={point['change'][1]}" for point in changed]
    axis.grid(False)
    axis.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    axis.set_yticks(range(len(cells)), [cell.replace("_", " ") for cell in cells], fontsize=7)
    drawn.colorbar(image, ax=axis, label=f"change of the cell's distance ({record['unit']})", shrink=0.7)
    return drawn
