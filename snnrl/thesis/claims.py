"""The thesis's explanations, each as a number with an interval and a criterion fixed beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from snnrl.body.world.geometry import escape_radius
from snnrl.intervals import student
from snnrl.model.draws import Draws, stream
from snnrl.recording.runs import Run
from snnrl.thesis.fit import best_region, describe, point_of, scores
from snnrl.thesis.published import published
from snnrl.thesis.verdicts import Sample, Share, compare_shares, welch

Runs = Mapping[str, Run]
SIDES = ("left", "right")
FIVE_ROBOTS = (
    "learning_disabled",
    "no_container_dopamine",
    "container_dopamine_learning",
    "fixed_container_dopamine",
    "benchmark",
)
CONTAINER_LEARNERS = tuple(f"secondary_behaviour/{robot}" for robot in FIVE_ROBOTS[1:4])


@dataclass(frozen=True)
class Claim:
    """What the thesis says, what was measured (value and 95 % interval), and when it was to hold."""

    section: str
    statement: str
    measured: str
    value: float
    low: float
    high: float
    unit: str
    criterion: str
    holds: bool


def pathways(sense: str, response: str) -> list[str]:
    """The projections of a response, those of the left and of the right sensor.

    Args:
        sense: food or container.
        response: attraction (left sensor to right motor, right to left) or avoidance.
    """
    motors = reversed(SIDES) if response == "attraction" else SIDES
    return [f"{side}_{sense}_to_{motor}_motor" for side, motor in zip(SIDES, motors, strict=True)]


def taxis(run: Run, kind: str, sense: str, response: str) -> np.ndarray:
    """`weight` or `eligibility`, mean over the `pathways` of a response, [T, B]."""
    return np.mean([run.of_projection(kind, name) for name in pathways(sense, response)], 0)


def escapes(run: Run) -> np.ndarray:
    """When each robot was beyond `escape_radius` from the item or had taken it (s), nan where it never was."""
    config = run.config
    coding, world = config["coding"], config["world"]
    limit = escape_radius(coding["slow"], coding["fast"], coding["tick"] / 1000, world["axle"])
    left = (run.series["nearest_item"] > limit) | (run.series["collection_rate"] > 0)
    return _first(run.time, left)


def first_food(run: Run) -> np.ndarray:
    """When each trial collected its first item (s), nan where it never did."""
    return _first(run.time, run.series["collection_rate"] > 0)


def _first(time: np.ndarray, happened: np.ndarray) -> np.ndarray:
    return np.where(happened.any(0), time[happened.argmax(0)], np.nan)


def differentiation(weights: Mapping[str, np.ndarray], sense: str = "food") -> np.ndarray:
    """How exclusively each motor neuron answers to one sensor: mean of |L - R| / (L + R) over them, [B].

    L and R are its mean weights from the left and the right sensor; neurons that have almost none (L + R below
    0.2 mV) are left out.
    """
    indices = []
    for motor in SIDES:
        left, right = (np.nanmean(weights[f"{side}_{sense}_to_{motor}_motor"], 1) for side in SIDES)
        with np.errstate(invalid="ignore", divide="ignore"):
            indices.append(np.where(left + right > 0.2, np.abs(left - right) / (left + right), np.nan))
    return np.asarray(np.nanmean(np.concatenate(indices, 1), 1))


def shuffled(weights: Mapping[str, np.ndarray], seed: int) -> dict[str, np.ndarray]:
    """The same weights dealt anew to the existing synapses of each projection and trial."""
    result = {}
    for name, values in weights.items():
        flat = values.reshape(len(values), -1)
        key = Draws(seed, torch.arange(len(flat))).at_start(stream("shuffle", name), flat.shape[1]).numpy()
        there = ~np.isnan(flat)
        dealt = np.full_like(flat, np.nan)
        for row, (present, order) in enumerate(zip(there, key, strict=True)):
            dealt[row, present] = flat[row, present][np.argsort(order[present])]
        result[name] = dealt.reshape(values.shape)
    return result


def settled(time: np.ndarray, values: np.ndarray, part: float = 0.9) -> np.ndarray:
    """When each column of `values` [T, B] first reached `part` of its mean over the last half, [B], s."""
    goal = part * values[len(values) // 2 :].mean(0)
    return _first(time, values >= goal)


def smooth(values: np.ndarray, width: int) -> np.ndarray:
    """Mean of the last `width` samples (fewer at the start), along the first axis."""
    total = np.concatenate([np.zeros_like(values[:1]), values.cumsum(0, dtype=float)])
    end = np.arange(1, len(values) + 1)
    start = np.maximum(end - width, 0)
    return np.asarray((total[end] - total[start]) / (end - start).reshape(-1, *[1] * (values.ndim - 1)))


def lead(more: np.ndarray, less: np.ndarray) -> tuple[float, float, float]:
    """By how much the mean of one sample exceeds another's, and Welch's interval of that."""
    return (float(more.mean() - less.mean()), *welch(Sample.of(more), Sample.of(less)))


def above_zero(section: str, statement: str, measured: str, found: tuple[float, float, float], unit: str) -> Claim:
    """A claim that holds where the whole interval of what was found (value, low, high) is above 0."""
    return Claim(section, statement, measured, *found, unit, "interval above 0", found[1] > 0)


def hunger_breaks_orbits(runs: Runs) -> Claim:
    with_, without = (
        Share(int(np.isfinite(escapes(runs[f"orbit/{robot}"])).sum()), len(runs[f"orbit/{robot}"].series["trials"]))
        for robot in ("learning", "positive_baseline")
    )
    found = compare_shares(with_, without)
    return above_zero(
        "4.1",
        "Hunger, the negative baseline of dopamine, is what breaks orbits.",
        "escapes with a negative baseline less escapes with a positive one",
        (100 * found.value, 100 * found.low, 100 * found.high),
        "% of trials",
    )


def _arrives(statement: str, measured: str, times: np.ndarray, said: float) -> Claim:
    """A claim of section 4.2 about when something has happened (s)."""
    low, high = student(times)
    mean = float(times.mean())
    criterion = f"mean between half and twice the published {said:g} s"
    return Claim("4.2", statement, measured, mean, low, high, "s", criterion, said / 2 <= mean <= 2 * said)


def attraction_settles(runs: Runs) -> Claim:
    run = runs["food_attraction/learning"]
    said = published()["said"]["attraction_settled"]
    width = max(1, len(run.time) // 20)
    return _arrives(
        f"Food attraction has settled after about {said:g} s.",
        f"time until the rate over the last {width * np.diff(run.time).mean():.2g} s reaches 90 % of the final rate",
        settled(run.time, smooth(run.series["collection_rate"], width)),
        said,
    )


def weights_saturate(runs: Runs) -> Claim:
    run = runs["food_attraction/learning"]
    said = published()["said"]["weights_saturated"]
    return _arrives(
        f"Attraction weights have risen to their maximum after about {said:g} s.",
        "time until the mean attraction weight reaches 90 % of its final value",
        settled(run.time, taxis(run, "weight", "food", "attraction")),
        said,
    )


def motor_neurons_differentiate(runs: Runs) -> Claim:
    weights = runs["food_attraction/learning"].weights
    excess = differentiation(weights) - differentiation(shuffled(weights, 0))
    return above_zero(
        "4.2",
        "Single motor neurons come to answer to one sensor only.",
        "differentiation index less that of the same weights dealt at random within each projection "
        f"(index {differentiation(weights).mean():.2f})",
        (float(excess.mean()), *student(excess)),
        "",
    )


def avoidance_levels_off(runs: Runs) -> Claim:
    with_, without = (
        taxis(runs[f"food_attraction/{robot}"], "weight", "food", "avoidance")[-20:].mean(0)
        for robot in ("learning", "no_hunger")
    )
    return above_zero(
        "4.2",
        "Avoidance weights settle at a low level because of the negative baseline.",
        f"avoidance weight at the end with the negative baseline ({with_.mean():.2f} mV) less that with "
        "a baseline of 0 "
        f"({without.mean():.2f} mV)",
        lead(with_, without),
        "mV",
    )


def poison_is_unlearnt(runs: Runs) -> Claim:
    learning, walk = (runs[f"food_poison/{robot}"] for robot in ("learning", "random_walk"))
    switch = float(learning.config["world"]["kinds"]["food"]["poison_from"])
    end = switch + 0.1 * (float(learning.time[-1]) - switch)
    rates = [run.rate(switch, end) for run in (learning, walk)]
    value, low, high = lead(rates[0], rates[1])
    return Claim(
        "4.3",
        "Attraction is unlearnt almost at once when food turns to poison: the rate falls to just "
        "below the random walk's.",
        f"rate in the {end - switch:.0f} s after the switch, learning ({rates[0].mean():.3f}) "
        f"less random walk ({rates[1].mean():.3f})",
        value,
        low,
        high,
        "items/s",
        "difference at or below 0",
        value <= 0,
    )


def threshold_protects(runs: Runs) -> Claim:
    with_, without = (
        runs[f"secondary_stimulus/{robot}"].of_projection("weight", "empty_container_touch_to_dopaminergic")[-1]
        for robot in ("learning", "no_burst_threshold")
    )
    return above_zero(
        "4.4",
        "The burst threshold is what keeps the empty container unlearnt.",
        f"weight of the empty container's touch without the threshold ({without.mean():.3f} mV) less with it "
        f"({with_.mean():.3f} mV)",
        lead(without, with_),
        "mV",
    )


def robots_are_in_order(runs: Runs) -> Claim:
    food = [Sample.of(runs[f"secondary_behaviour/{robot}"].trials["food"]) for robot in FIVE_ROBOTS]
    steps = [(after.mean - before.mean, *welch(after, before)) for before, after in pairwise(food)]
    value, low, high = min(steps)
    return Claim(
        "4.5",
        "The more of the container's dopamine response a robot has, the more food it finds; the benchmark finds most.",
        "smallest step between robots in the published order",
        value,
        low,
        high,
        "items",
        "every step above 0",
        value > 0,
    )


def failures_are_synchronised(runs: Runs) -> Claim:
    return _synchronised("4.5", [runs[name] for name in CONTAINER_LEARNERS])


def dual_failures_are_synchronised(runs: Runs) -> Claim:
    return _synchronised("4.6", [runs["dual_learning/learning"]])


def _synchronised(section: str, found: Sequence[Run]) -> Claim:
    """That trials which fail are those in which the container taxis's two responses rise and fall together."""
    together = np.concatenate([_togetherness(run) for run in found])
    failed = np.concatenate([run.trials["correct"] == 0 for run in found])
    wrong, right = (together[group & np.isfinite(together)] for group in (failed, ~failed))
    return above_zero(
        section,
        "Trials fail when the weights of attraction and avoidance have become synchronised.",
        f"their correlation over the second half of a trial, failed ({len(wrong)} trials) less correct ({len(right)})",
        lead(wrong, right) if min(len(wrong), len(right)) > 1 else (np.nan, -np.inf, np.inf),
        "",
    )


def _togetherness(run: Run) -> np.ndarray:
    """Correlation of attraction and avoidance over the second half of each trial, [B]; nan where one is constant."""
    late = slice(len(run.time) // 2, None)
    attraction, avoidance = (taxis(run, "weight", "container", side)[late] for side in ("attraction", "avoidance"))
    return np.array([_correlation(a, b) for a, b in zip(attraction.T, avoidance.T, strict=True)])


def optimum_is_among_the_best(runs: Runs) -> Claim:
    found = scores(runs)
    best, region = best_region(found)
    optimum = published()["stdp_search"]
    at = next(name for name in found if all(value == optimum[key] for key, value in point_of(name).items()))
    return Claim(
        "3.7",
        "The parameters of STDP that collect most food are those published.",
        f"food at the best of {len(found)} points of the grid ({describe(best)}) less food at the published point",
        *lead(found[best], found[at]),
        "items",
        "a one-sided Welch test (5 %) does not tell the two apart",
        at in region,
    )


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1]) if a.std() and b.std() else float("nan")


CLAIMS: Mapping[Callable[[Runs], Claim], tuple[str, ...]] = {
    hunger_breaks_orbits: ("orbit/learning", "orbit/positive_baseline"),
    attraction_settles: ("food_attraction/learning",),
    weights_saturate: ("food_attraction/learning",),
    motor_neurons_differentiate: ("food_attraction/learning",),
    avoidance_levels_off: ("food_attraction/learning", "food_attraction/no_hunger"),
    poison_is_unlearnt: ("food_poison/learning", "food_poison/random_walk"),
    threshold_protects: ("secondary_stimulus/learning", "secondary_stimulus/no_burst_threshold"),
    robots_are_in_order: tuple(f"secondary_behaviour/{robot}" for robot in FIVE_ROBOTS),
    optimum_is_among_the_best: ("stdp_search",),
    failures_are_synchronised: CONTAINER_LEARNERS,
    dual_failures_are_synchronised: ("dual_learning/learning",),
}


def claims(runs: Runs) -> list[Claim]:
    """All whose runs are there."""
    return [
        claim(runs)
        for claim, needed in CLAIMS.items()
        if all(name in runs or any(run.startswith(f"{name}/") for run in runs) for name in needed)
    ]
