"""What is kept of a run: its probes, and what it has come to at the end; all that differs between robots and tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import torch

from snnrl.extras import lacks
from snnrl.recording.criteria import correct
from snnrl.recording.probes import Moment, Probe, followed, food, other_weights, probes_of
from snnrl.simulation import Simulation
from snnrl.tasks.responses import Series, quarters
from snnrl.tasks.task import Task

BINS = 40  # of the histogram of a task's weights
TOP = 0.95  # part of the largest weight from which on a weight counts as at the top


@dataclass(frozen=True)
class Ending:
    """What a run has come to.

    Attributes:
        columns: of trials.csv, [B] each; what is nan is left empty.
        results: of the summary.
        arrays: of series.npz besides the samples.
        pictures: PNG and SVG files, by their names.
    """

    columns: Mapping[str, np.ndarray]
    results: Mapping[str, float | None]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    pictures: Mapping[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Kept:
    """What is kept of a simulation.

    Attributes:
        probes: read at every sample.
        end: what the run has come to, from all samples.
        from_start: whether the state before the first tick is a sample too.
        watched: whether there are alarms, histograms and pictures of it while it runs, and its weights at the end.
    """

    probes: tuple[Probe, ...]
    end: Callable[[Series], Ending]
    from_start: bool = False
    watched: bool = False


def kept_of(simulation: Simulation[Any], rules: Mapping[str, str]) -> Kept:
    """What is kept, by the type of the situation.

    Args:
        rules: by which a trial of a robot is correct, see `snnrl.recording.criteria.correct`.
    """
    probes = probes_of(simulation)
    if isinstance(simulation.situation, Task):
        return Kept(tuple(probes), partial(end_of_task, simulation), from_start=True)
    if rules:
        probes.append(fraction_correct(rules))
    return Kept(tuple(probes), partial(end_of_robot, simulation, rules), watched=True)


def fraction_correct(rules: Mapping[str, str]) -> Probe:
    """Whether each trial has learnt by now, by the rules of an experiment."""

    def read(moment: Moment) -> torch.Tensor:
        return correct(moment.simulation.network, rules).double()

    return Probe("correct", read, ("trial",), "", tag="behaviour/fraction correct", metric=True, series=False)


def end_of_robot(simulation: Simulation[Any], rules: Mapping[str, str], series: Series) -> Ending:
    """Touches, whether a trial is correct, and mean weights (mV) of the projections with a role.

    The series get the names of these `projections` [P].
    """
    projections = followed(simulation)
    touches = simulation.situation.world.touches.cpu().numpy()
    learnt = correct(simulation.network, rules).double() if rules else torch.full((simulation.trials,), torch.nan)
    taken = food(simulation).double()
    return Ending(
        columns={
            **dict(zip(simulation.situation.world.kinds.names, touches.T, strict=True)),
            "correct": learnt.cpu().numpy(),
            **{projection.name: projection.mean_weight().cpu().numpy() for projection in projections},
        },
        results={
            "food_mean": float(taken.mean()),
            "food_sd": float(taken.std()) if len(taken) > 1 else None,
            "correct_fraction": float(learnt.mean()) if rules else None,
        },
        arrays={"projections": np.array([projection.name for projection in projections])},
    )


def end_of_task(simulation: Simulation[Task], series: Series) -> Ending:
    """Rewards and mean weight, and what has come of a watched synapse, and of stimuli; results are means over trials.

    The series get, for the plastic weights of each trial but the watched one, a `histogram` [B, 40] with the `edges`
    [41] (mV).
    """
    task, most = simulation.situation, largest_weight(simulation)
    others = [weight.cpu().numpy() for weight in other_weights(simulation)]
    edges = np.linspace(0.0, most, BINS + 1)
    arrays = {"edges": edges, "histogram": np.stack([np.histogram(weight, edges)[0] for weight in others])}
    columns: dict[str, np.ndarray] = {key: series[key][-1] for key in ("rewards", "mean_weight")}
    if task.coincidence is not None:
        columns |= reinforcement(series, others, TOP * most)
    if task.stimuli is not None:
        columns |= conditioning(series, task.stimuli.rewarded)
    pictures = {} if lacks("figures") else draw_task(task, {**series, **arrays})
    means = {key: float(values.mean()) for key, values in columns.items() if np.isfinite(values).all()}
    return Ending(columns, means, arrays, pictures)


def draw_task(task: Task, series: Series) -> dict[str, bytes]:
    """What came of a task as PNG and SVG files, by their names; needs the extra `figures`."""
    from snnrl.drawing import style, task_figures

    drawn = {}
    if task.coincidence is not None:
        drawn["reinforcement"] = task_figures.draw_reinforcement(series)
    if task.stimuli is not None:
        rewarded, window = task.stimuli.rewarded, task.stimuli.window
        drawn["conditioning"] = task_figures.draw_conditioning(series, rewarded, window)
    return {f"{name}{kind}": file for name, figure in drawn.items() for kind, file in style.encoded(figure).items()}


def largest_weight(simulation: Simulation[Any]) -> float:
    """That a plastic synapse may have (mV)."""
    rules = [projection.rule for projection in simulation.network.projections.values()]
    return max((rule.weight_max for rule in rules if rule is not None), default=1.0)


def reinforcement(series: Series, others: list[np.ndarray], top: float) -> dict[str, np.ndarray]:
    """The watched synapse at the end, when it first came to the top (mV), and its rivals there, [B] each."""
    reached = series["chosen_weight"] >= top
    return {
        "chosen_weight": series["chosen_weight"][-1],
        "seconds_to_top": np.where(reached.any(0), series["time"][reached.argmax(0)], np.nan),
        "others_at_top": np.array([(weight >= top).mean() if len(weight) else 0.0 for weight in others]),
    }


def conditioning(series: Series, rewarded: int) -> dict[str, np.ndarray]:
    """Mean responses (spikes) to the rewarded and the other stimuli in the first and the last quarter, [B] each."""
    result = {}
    for name, response in zip(("first", "last"), quarters(series), strict=True):
        result[f"response_{name}"] = response[:, rewarded]
        result[f"others_{name}"] = np.nanmean(np.delete(response, rewarded, 1), 1)
    return result
