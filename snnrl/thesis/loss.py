"""The loss of the calibration: how far what was measured is from every published number.

A cell is a signed distance in a unit in which our own sample has no part: neither a wide spread nor few trials bring a
cell closer.

| cell | distance |
|---|---|
| a mean | (ours - published) / the published SD, or a tenth of the mean where none is published |
| its spread, where an SD is published | log(our SD / the published SD) |
| a fraction of trials | (ours - published) / 0.1 |
| the share of trapped trials, where food is published | as a fraction; published: 0 |
| the share of weak failures, of robots of which the text says how they fail | as a fraction; published: 0 |
| a time at which learning has come to something, "about" | log2(ours / published) |
| the background rate | (ours - published) / half of the last digit published |

A trial is trapped if it takes no food in its last 300 s, or in the last 30 % of one shorter than 1000 s. One that is
not correct has failed strongly if the attraction of both sides is strong all the same, more than the criterion's
0.5 mV: then it fails by an avoidance that is nearly as strong; else weakly. Weak failures are counted among all trials,
as one of the few that fail would else decide alone. The loss is the root mean square of all cells, each limited to 10,
so that no single one decides alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from snnrl.recording.criteria import STRENGTH
from snnrl.thesis.verdicts import MARGIN

UNIT = "units of the loss"  # in words, of all distances
FARTHEST = 10.0
TAIL, TAIL_PART = 300.0, 0.3  # s, and the part of a shorter trial, in which a trial without food is trapped
Cells = Iterator[tuple[str, float]]


@dataclass(frozen=True)
class Outcome:
    """What the trials of one robot came to, [B] each.

    Attributes:
        food: items taken. late: those of them in the `tail` of the trial.
        learnt: whether it is correct. contrast: whether it tells the containers apart; None where there is one kind.
        attraction: mean weight (mV) of the container taxis's attraction, [2, B], left and right sensor; None without.
        saturated, settled: when the attraction's weight and the rate of food have come near to their final values (s),
            nan where they do not; None of robots of which nothing is said.
    """

    food: np.ndarray
    late: np.ndarray
    learnt: np.ndarray
    contrast: np.ndarray | None = None
    attraction: np.ndarray | None = None
    saturated: np.ndarray | None = None
    settled: np.ndarray | None = None


def tail(seconds: float) -> float:
    """How long before its end a trial of so many s is looked at for food, s."""
    return min(TAIL, TAIL_PART * seconds)


def mean_distance(ours: np.ndarray, published: Mapping[str, float]) -> float:
    """Of a mean, [n] values; of none at all it is as far as can be."""
    if not len(ours):
        return FARTHEST
    return (float(np.mean(ours)) - published["mean"]) / published.get("sd", MARGIN * published["mean"])


def spread_distance(ours: np.ndarray, published: Mapping[str, float]) -> float:
    """Of a standard deviation over at least two values."""
    spread = float(np.std(ours, ddof=1))
    return math.log(spread / published["sd"]) if spread else -FARTHEST


def fraction_distance(hits: np.ndarray, published: float) -> float:
    """Of a fraction of trials, bool [n]."""
    return (float(np.mean(hits)) - published) / MARGIN


def time_distance(ours: np.ndarray, published: float) -> float:
    """Of a time that is published as "about", [n] with nan where it never came; if in none, as far as can be."""
    came = ours[np.isfinite(ours)]
    return float(np.log2(np.mean(came) / published)) if len(came) else FARTHEST


def weak_failure_distance(learnt: np.ndarray, attraction: np.ndarray, published: float) -> float:
    """Of the fraction of all trials that fail weakly."""
    return fraction_distance(~learnt & (attraction <= STRENGTH).any(0), published)


def run_cells(experiment: str, robot: str, ours: Outcome, published: Mapping[str, Any]) -> Cells:
    """Name and distance of every published cell of one robot."""

    def found(kind: str) -> Any:
        return published[kind].get(experiment, {}).get(robot)

    name = f"{experiment}/{robot}"
    if (cell := found("food")) is not None:
        yield f"{name}/food", mean_distance(ours.food, cell)
        if len(ours.food) > 1:
            yield f"{name}/food spread", spread_distance(ours.food, cell)
        yield f"{name}/trapped", fraction_distance(ours.late == 0, published["trapped"])
    if (cell := found("correct")) is not None:
        yield f"{name}/correct", fraction_distance(ours.learnt, cell)
    if (cell := found("failed_weakly")) is not None:
        assert ours.attraction is not None
        yield f"{name}/failed weakly", weak_failure_distance(ours.learnt, ours.attraction, cell)
    if (cell := found("contrast")) is not None:
        assert ours.contrast is not None
        yield f"{name}/contrast", fraction_distance(ours.contrast, cell["fraction"])
    for what, times, said in (
        ("weights saturated", ours.saturated, "weights_saturated"),
        ("attraction settled", ours.settled, "attraction_settled"),
    ):
        if times is not None:
            yield f"{name}/{what}", time_distance(times, published["said"][said])


def orbit_cells(robot: str, times: np.ndarray, published: Mapping[str, Any]) -> Cells:
    """Of a robot's escapes from its orbit: when [B] (s), nan where it stays."""
    cell = published["escaped"]["orbit"][robot]
    escaped = np.isfinite(times)
    yield f"orbit/{robot}/escaped", fraction_distance(escaped, cell["fraction"])
    if "mean" in cell:
        yield f"orbit/{robot}/time", mean_distance(times[escaped], cell)


def background_cells(rate: np.ndarray, published: Mapping[str, Any]) -> Cells:
    """Of the dopaminergic neurons' firing without food [B], Hz."""
    said = published["said"]["background_rate"]
    yield "background rate", (float(np.mean(rate)) - said["mean"]) / said["rounding"]


def food_cells(dose: np.ndarray, waited: np.ndarray, published: Mapping[str, Any]) -> Cells:
    """Of food items: what each released on average (uM) [n], and the s from entering its container to taking it [n]."""
    yield "dose", mean_distance(dose, published["said"]["dose"])
    yield "entering to food", mean_distance(waited, published["said"]["entering_to_food"])


def loss(found: Mapping[str, float]) -> float:
    """Root mean square of the cells' distances, each limited to FARTHEST."""
    return math.sqrt(sum(min(abs(value), FARTHEST) ** 2 for value in found.values()) / len(found))
