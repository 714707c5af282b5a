"""What was fitted and how: the calibration's record, and the grid over the parameters of STDP."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from snnrl.configuration.compose import compose
from snnrl.drawing.palette import CYCLE, OTHER, PALE
from snnrl.drawing.style import figure, legend, quantity, styled
from snnrl.recording.runs import Run
from snnrl.schema import PlasticityConfig, bounds_of
from snnrl.thesis.box import FREE, Choice
from snnrl.thesis.loss import FARTHEST
from snnrl.thesis.published import published
from snnrl.thesis.verdicts import p_greater

CALIBRATION, POINTS = (Path(__file__).with_name(f"calibration.{kind}") for kind in ("json", "csv"))
FORMER_UNIT = "standard errors"  # of a record that does not say its unit: of the difference, our spread included
PLANES = (("potentiation", "depression"), ("tau_plus", "tau_minus"))
SHOWN = 0.5  # units of the loss, the least change that the picture of the sensitivity tells of
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # on the values in conf/


@dataclass(frozen=True)
class Point:
    """Free values that all cells have judged, `of` the search or of its finalists.

    Attributes:
        values: free values by their keys, numbers as such.
        distances: of the cells.
    """

    of: str
    number: int
    trials: int
    loss: float
    values: Mapping[str, float | str]
    distances: Mapping[str, float]


def calibration() -> dict[str, Any] | None:
    """The record of the fit that conf/ holds, `unit` that of its losses and distances; None before there is one."""
    return {"unit": FORMER_UNIT, **json.loads(CALIBRATION.read_text())} if CALIBRATION.exists() else None


def points() -> list[Point]:
    """Those of the record of the fit; free values have a dot in their names, cells none."""
    if not POINTS.exists():
        return []
    with POINTS.open() as file:
        rows = list(csv.DictReader(file))
    keys = [key for key in rows[0] if "." in key] if rows else []
    cells = [key for key in rows[0] if key not in (*keys, "of", "number", "trials", "loss")] if rows else []
    return [
        Point(
            row["of"],
            int(row["number"]),
            int(row["trials"]),
            float(row["loss"]),
            {key: _number(row[key]) for key in keys},
            {cell: float(row[cell]) for cell in cells if row[cell]},
        )
        for row in rows
    ]


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def noise(found: Sequence[Point]) -> float:
    """SD of the difference between the losses of the same values in the search and as finalists; nan of too few."""
    searched = {point.number: point.loss for point in found if point.of == "search"}
    differences = [point.loss - searched[point.number] for point in found if point.of == "finalists"]
    return float(np.std(differences, ddof=1)) if len(differences) > 2 else float("nan")


def within_noise(found: Sequence[Point]) -> list[Point]:
    """Points of the search whose loss is not more than two `noise` above the least; none while that is not known."""
    searched = [point for point in found if point.of == "search"]
    least = min(point.loss for point in searched)
    return [point for point in searched if point.loss <= least + 2 * noise(found)]


def pins(found: Sequence[Point]) -> list[dict[str, str]]:
    """Of each free value: where the points within noise of the best have it, and the least loss by each choice."""
    searched, near = [point for point in found if point.of == "search"], within_noise(found)
    result = []
    for key, free in FREE.items():
        if key not in searched[0].values:
            continue
        values, least = [point.values[key] for point in near], ""
        if isinstance(free, Choice):
            spread = ", ".join(sorted({str(value) for value in values}))
            by_choice: dict[str, list[float]] = {}
            for point in searched:
                by_choice.setdefault(str(point.values[key]), []).append(point.loss)
            least = "; ".join(
                f"{value} {min(losses):.2f} of {len(losses)}" for value, losses in sorted(by_choice.items())
            )
        else:
            spread = f"{min(values):.3g} to {max(values):.3g}" if values else ""
        if spread or least:
            result.append({"key": key, "near": spread, "least": least})
    return result


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


@styled
def heat_maps(runs: Mapping[str, Run]) -> Figure:
    """Mean score over both planes of the grid, the published point, and points that are not worse than the best."""
    found = scores(runs)
    _, region = best_region(found)
    drawn, axes = figure(1, 2, width=7.2, height=3.3)
    means = [values.mean() for values in found.values()]
    for axis, (x, y) in zip(axes, PLANES, strict=True):
        points = [(point_of(name), name) for name in found if set(point_of(name)) == {x, y}]
        across, up = (sorted({point[key] for point, _ in points}) for key in (x, y))
        score = np.full((len(up), len(across)), np.nan)
        for point, name in points:
            row, column = up.index(point[y]), across.index(point[x])
            score[row, column] = found[name].mean()
            if name in region:
                axis.plot(
                    column, row + 0.33, ".", color="white", mec="black", mew=0.5, ms=6, label="not worse than best"
                )
        image = axis.imshow(score, origin="lower", cmap="viridis", vmin=min(means), vmax=max(means), aspect="auto")
        for (row, column), value in np.ndenumerate(score):
            dark = value < 0.5 * (min(means) + max(means))
            axis.text(
                column, row, f"{value:.0f}", ha="center", va="center", fontsize=7, color="white" if dark else "black"
            )
        axis.grid(False)
        axis.set_xticks(range(len(across)), [f"{value:g}" for value in across])
        axis.set_yticks(range(len(up)), [f"{value:g}" for value in up])
        theirs = [place_of(published()["stdp_search"][key], at) for key, at in ((x, across), (y, up))]
        axis.plot(*theirs, "s", ms=26, mfc="none", mec=CYCLE[3], mew=1.5, label="published best point")
        labels = (axis_name(f"network.plasticity.{key}") for key in (x, y))
        axis.set(**dict(zip(("xlabel", "ylabel"), labels, strict=True)))
    drawn.colorbar(image, ax=axes, label="Mean food in a trial (items)")
    legend(drawn, loc="outside lower center", ncols=2, markerscale=0.4)
    return drawn


def place_of(value: float, along: Sequence[float]) -> float:
    """Where a value is on an axis whose ticks, in equal steps, are some others; between them by its logarithm."""
    return float(np.interp(np.log(value), np.log(along), range(len(along)), np.nan, np.nan))


def axis_name(key: str) -> str:
    """What an axis is called that has values of a key of the configuration: with its unit, if it has one."""
    node: Any = compose("+experiment=dual_learning")
    *parts, last = key.split(".")
    for part in parts:
        node = node[part] if isinstance(node, dict) else getattr(node, part)
    return quantity(short_name(key), bounds_of(node, last)["unit"])


@styled
def history(_: Mapping[str, Run]) -> Figure | None:
    """Every point of the calibration, and the best so far."""
    searched = [point for point in points() if point.of == "search"]
    if not searched:
        return None
    losses, numbers = [point.loss for point in searched], [point.number for point in searched]
    drawn, axis = figure(height=2.6)
    axis.plot(numbers, losses, ".", color=OTHER, label="a point that every cell has judged")
    axis.step(numbers, np.minimum.accumulate(losses), where="post", color=CYCLE[0], label="best so far")
    axis.set(xlabel="Point of the study", ylabel=f"RMS distance ({_unit()})", ylim=(0, None))
    legend(axis, loc="upper right")
    return drawn


def _unit() -> str:
    return str((calibration() or {"unit": FORMER_UNIT})["unit"])


def short_name(key: str) -> str:
    """Of a free value, for an axis."""
    return " ".join(key.split(".")[-2:]).replace("_", " ")


@styled
def pinned(_: Mapping[str, Run]) -> Figure | None:
    """The loss over each free value, with the points within noise of the best."""
    found = points()
    searched = [point for point in found if point.of == "search"]
    keys = [key for key in searched[0].values if len({point.values[key] for point in searched}) > 1] if searched else []
    if not keys:
        return None
    near, columns = within_noise(found), 5
    rows = -(-len(keys) // columns)
    drawn, axes = figure(rows, columns, width=9.0, height=1.75 * rows + 0.5, sharey=True, squeeze=False)
    for axis, key in zip(axes.flat, keys, strict=False):
        named = sorted({str(point.values[key]) for point in searched})
        numeric = all(isinstance(point.values[key], float) for point in searched)
        for shown, colour, label, size in (
            (searched, PALE, "a point that every cell has judged", 4),
            (near, CYCLE[0], "within noise of the best", 6),
        ):
            if not shown:
                continue
            x = [point.values[key] if numeric else named.index(str(point.values[key])) for point in shown]
            axis.plot(x, [point.loss for point in shown], ".", color=colour, ms=size, label=label)
        if not numeric:
            axis.set_xticks(range(len(named)), [name.replace("_", " ") for name in named], fontsize=7)
            axis.set_xlim(-0.5, len(named) - 0.5)
        axis.set_xlabel(axis_name(key) if numeric else quantity(short_name(key), ""), fontsize=7)
    for axis in axes.flat[len(keys) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel(f"RMS distance\n({_unit()})")
    legend(drawn, loc="outside upper right", ncols=2)
    return drawn


FRONTS = (  # cells that pull against each other
    (
        "Food attraction",
        ("food_attraction/learning/",),
        "Container behaviours",
        ("container_dopamine", "dual_learning/"),
    ),
    (
        "Dose",
        ("dose",),
        "Container behaviours learnt",
        ("container_dopamine_learning/correct", "dual_learning/learning/correct"),
    ),
)


def rms(point: Point, parts: Sequence[str]) -> float:
    """Root mean square of those of a point's distances whose names have one of the parts."""
    chosen = [min(abs(v), FARTHEST) for cell, v in point.distances.items() if any(part in cell for part in parts)]
    return float(np.sqrt(np.mean(np.square(chosen))))


def front(pairs: Sequence[tuple[float, float]]) -> list[int]:
    """Which of some pairs no other beats in one half without being worse in the other, by their first half."""
    order = sorted(range(len(pairs)), key=lambda k: pairs[k])
    result: list[int] = []
    for k in order:
        if not result or pairs[k][1] < pairs[result[-1]][1]:
            result.append(k)
    return result


@styled
def fronts(_: Mapping[str, Run]) -> Figure | None:
    """Cells that cannot be had together: every point by its distance from both, and those that none beats."""
    searched = [point for point in points() if point.of == "search"]
    if len(searched) < 2:
        return None
    drawn, axes = figure(1, len(FRONTS), width=7.6, height=3.3)
    for axis, (across, first, up, second) in zip(axes, FRONTS, strict=True):
        pairs = [(rms(point, first), rms(point, second)) for point in searched]
        colours = [point.values["coding.exploration_gain"] for point in searched]
        shown = axis.scatter(*zip(*pairs, strict=True), c=colours, s=10, cmap="viridis", label="a point of the search")
        best = [pairs[k] for k in front(pairs)]
        axis.step(*zip(*best, strict=True), where="post", color=CYCLE[3], lw=1.2, label="none is better in both")
        axis.set(xlabel=f"{across}: RMS distance\n({_unit()})", xlim=(0, None), ylim=(0, None))
        axis.set(ylabel=f"{up}: RMS distance\n({_unit()})")
    legend(drawn, loc="outside upper left")
    drawn.colorbar(shown, ax=axes, label=axis_name("coding.exploration_gain"))
    return drawn


@styled
def sensitivity(_: Mapping[str, Run]) -> Figure | None:
    """How each cell moves when one value is changed; those that nothing moves by SHOWN are left out."""
    record = calibration() or {}
    points = record.get("sensitivity", [])
    changed = [point for point in points if point["change"][0]]
    if not changed:
        return None
    base = next(point for point in points if not point["change"][0])
    cells = sorted(base["distances"])
    shift = np.array([[p["distances"].get(c, np.nan) - base["distances"][c] for p in changed] for c in cells])
    moved = (np.abs(shift) >= SHOWN).any(1)
    cells, shift = [cell for cell, moves in zip(cells, moved, strict=True) if moves], shift[moved]
    drawn, axis = figure(width=3.6 + 0.3 * len(changed), height=0.22 * len(cells) + 2.2)
    most = 0.5 * FARTHEST
    image = axis.imshow(shift, cmap="PuOr", vmin=-most, vmax=most, aspect="auto")
    for (row, column), value in np.ndenumerate(shift):
        if abs(value) >= SHOWN:
            colour = "white" if abs(value) > 0.6 * most else "black"
            axis.text(column, row, f"{value:+.1f}", ha="center", va="center", fontsize=6, color=colour)
    names = [
        f"{quantity(short_name(key), '')} = {value}".replace("_", " ") for key, value in (p["change"] for p in changed)
    ]
    axis.grid(False)
    axis.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    axis.set_yticks(range(len(cells)), [cell.replace("_", " ") for cell in cells], fontsize=7)
    drawn.colorbar(image, ax=axis, label=f"Change of the cell's distance ({record['unit']})", shrink=0.7, extend="both")
    return drawn
