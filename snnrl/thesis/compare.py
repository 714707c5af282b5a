"""Every published cell beside ours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from snnrl.files import finite
from snnrl.recording.runs import Run
from snnrl.thesis.claims import escapes
from snnrl.thesis.published import published
from snnrl.thesis.verdicts import Difference, Sample, Share, compare_means, compare_shares

Value = Sample | Share
MOST = 1000  # trials that are run for the sake of a verdict


@dataclass(frozen=True)
class Cell:
    """One published number and ours."""

    experiment: str
    robot: str
    quantity: str
    unit: str
    published: Value
    ours: Value
    difference: Difference

    @property
    def name(self) -> tuple[str, str, str]:
        return self.experiment, self.robot, self.quantity

    @property
    def verdict(self) -> str:
        return self.difference.verdict

    def to_json(self, judged: bool = True) -> dict[str, Any]:
        """All of it; `trials_needed` is null where no number would do. Not `judged`, without what a verdict says."""
        d = self.difference
        needed = int(d.trials_needed) if np.isfinite(d.trials_needed) else None
        judgement = {"margin": d.margin, "trials_needed": needed, "verdict": self.verdict}
        return {
            "experiment": self.experiment,
            "robot": self.robot,
            "quantity": self.quantity,
            "unit": self.unit,
            "published": vars(self.published),
            "ours": vars(self.ours),
            "difference": finite(d.value),
            "interval": [finite(d.low), finite(d.high)],
            "effect_size": finite(d.effect),
            **(judgement if judged else {}),
        }


def enough(cells: Sequence[Cell]) -> dict[str, int]:
    """Trials of the runs with a cell that is inconclusive for want of ours, by EXPERIMENT/ROBOT; MOST at most."""
    sizes: dict[str, int] = {}
    for cell in cells:
        needed = cell.difference.trials_needed
        if cell.verdict == "inconclusive" and cell.ours.n < needed < np.inf:
            name = f"{cell.experiment}/{cell.robot}"
            sizes[name] = max(sizes.get(name, 0), min(MOST, int(needed)))
    return sizes


def tally(cells: Sequence[Cell]) -> str:
    """How many cells got which verdict, in words."""
    count = Counter(cell.verdict for cell in cells)
    return (
        f"{count['equivalent']} equivalent, {count['inconclusive']} inconclusive, {count['differs']} differ "
        f"of {len(cells)} published cells"
    )


def contrast(weights: Mapping[str, np.ndarray], factor: float) -> np.ndarray:
    """Trials whose food container's touch excites dopamine more than `factor` times the empty one's, bool [B].

    Args:
        weights: mean weights of projections by name, [B] each.
    """
    food, empty = (weights[f"{kind}_container_touch_to_dopaminergic"] for kind in ("food", "empty"))
    return np.asarray(food > factor * empty)


def compare(runs: Mapping[str, Run]) -> list[Cell]:
    """All published cells whose runs are there, by experiment and robot."""
    return [cell for name, run in runs.items() for cell in _cells(name, run)]


def _cells(name: str, run: Run) -> Iterator[Cell]:
    experiment, _, robot = name.partition("/")
    theirs = published()
    trials = theirs["trials"]

    def found(kind: str) -> Any:
        return theirs[kind].get(experiment, {}).get(robot)

    def means(quantity: str, unit: str, values: np.ndarray, value: Sample) -> Cell:
        ours = Sample.of(values)
        return Cell(experiment, robot, quantity, unit, value, ours, compare_means(ours, value))

    def shares(quantity: str, hits: np.ndarray, fraction: float, n: int) -> Cell:
        ours, value = Share(int(np.sum(hits)), len(hits)), Share(round(fraction * n), n)
        return Cell(experiment, robot, quantity, "of trials", value, ours, compare_shares(ours, value))

    if (value := found("food")) is not None:
        yield means("food", "items", run.trials["food"], Sample(value["mean"], value["sd"], trials))
    if (value := found("correct")) is not None:
        yield shares("learnt", run.trials["correct"] == 1, value, trials)
    if (value := found("contrast")) is not None:
        quantity = f"food container's touch over {value['factor']:g} x the empty one's"
        yield shares(quantity, contrast(run.trials, value["factor"]), value["fraction"], trials)
    if (value := found("escaped")) is not None:
        times = escapes(run)
        yield shares("escaped", np.isfinite(times), value["fraction"], theirs["escaped"]["trials"])
        if "mean" in value and np.isfinite(times).any():
            yield means(
                "escape time", "s", times[np.isfinite(times)], Sample(value["mean"], None, theirs["escaped"]["trials"])
            )
