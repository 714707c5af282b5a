"""What is kept of a task: series in memory, TensorBoard events as it goes, files and the figure at the end."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from snnrl.drawing.task_figures import draw_conditioning, draw_reinforcement, quarters
from snnrl.engines import Engine
from snnrl.files import sync, write
from snnrl.simulation import Simulation
from snnrl.tasks.task import Task

BINS = 40  # of the histogram of weights


class TaskRecorder:
    """Samples a task.

    Args:
        simulation: what is sampled.
        folder: of the run.
        tensorboard: whether to write events.
        state: what `state_dict` gave of the recorder of the run's part so far.
    """

    def __init__(
        self, simulation: Simulation[Task], folder: Path, tensorboard: bool, state: Mapping[str, Any] | None = None
    ) -> None:
        self.simulation, self.folder = simulation, folder
        self.writer = SummaryWriter(str(folder)) if tensorboard else None
        self.groups = list(simulation.network.groups)
        self._sizes = torch.tensor([g.size for g in simulation.network.groups.values()])
        self._samples: dict[str, list[np.ndarray]] = {}
        if state is None:
            self._before = self._counts()
            self._keep(self._state())
        else:
            self._samples = {key: list(values.numpy()) for key, values in state["samples"].items()}
            self._before = state["before"]

    def state_dict(self) -> dict[str, Any]:
        """All that has been sampled, and how many bytes of events are on the disk for good."""
        samples = {key: torch.from_numpy(np.stack(values)) for key, values in self._samples.items()}
        return {"samples": samples, "before": self._before, "events": self._written()}

    def _written(self) -> int:
        if self.writer is None:
            return 0
        self.writer.flush()
        files = sorted(self.folder.glob("events.out.tfevents.*"))
        for file in files:
            sync(file)
        return sum(file.stat().st_size for file in files)

    def most(self, done: int) -> int:
        """How many ticks may follow at once after `done`."""
        return 1 << 60

    def advance(self, engine: Engine, done: int, ticks: int) -> None:
        """Run the next ticks."""
        self.simulation.run(engine, ticks)

    def show(self, done: int) -> None:
        """There are no pictures while a task runs."""

    def _counts(self) -> tuple[float, torch.Tensor]:
        network = self.simulation.network
        return int(network.time) / 1000.0, network.spike_count.cpu().clone()

    def sample(self) -> tuple[str, list[str]]:
        """Take one sample; returns how many rewards there were, in words, and no alarms."""
        seconds, spikes = self._counts()
        then, spikes_then = self._before
        self._before = seconds, spikes
        state = self._state()
        self._keep(state)
        self._keep({"firing_rate": (spikes - spikes_then).float() / (self._sizes * (seconds - then))})
        if self.writer is not None:
            rates = self._samples["firing_rate"][-1].mean(0)
            scalars = {f"firing rate, Hz/{group}": rate for group, rate in zip(self.groups, rates, strict=True)}
            scalars |= {f"task/{key}": float(value.double().mean()) for key, value in state.items() if value.dim() == 1}
            for name, value in scalars.items():
                self.writer.add_scalar(name, value, round(seconds))
        return f"{float(state['rewards'].double().mean()):.1f} rewards", []

    def _keep(self, values: dict[str, torch.Tensor]) -> None:
        for key, value in values.items():
            self._samples.setdefault(key, []).append(value.cpu().numpy().copy())

    def _state(self) -> dict[str, torch.Tensor]:
        network, task = self.simulation.network, self.simulation.situation
        assert network.dopamine is not None
        state = {
            "time": torch.tensor(int(network.time) / 1000.0),
            "rewards": task.reward.given,
            "dopamine": network.dopamine.level,
            "mean_weight": self._of_trials(self._others(), torch.mean),
        }
        if task.coincidence is not None:
            state |= {
                "chosen_weight": network.synapses.weight[task.coincidence.synapse],
                "max_weight": self._of_trials(self._others(), torch.amax),
                "coincidences": task.coincidence.count,
            }
        if task.stimuli is not None:
            state |= {"presented": task.stimuli.presented, "response": task.stimuli.response}
        return state

    def _others(self) -> list[torch.Tensor]:
        """Plastic weights of each trial but the chosen one's, B tensors."""
        network, task = self.simulation.network, self.simulation.situation
        table = network.synapses
        use = torch.ones(table.plastic, dtype=torch.bool, device=network.device)
        if task.coincidence is not None and int(task.coincidence.synapse.max()) < table.plastic:
            use[task.coincidence.synapse] = False
        weight, trial = table.weight[: table.plastic], table.trial[: table.plastic]
        return [weight[use & (trial == k)] for k in range(network.trials)]

    @staticmethod
    def _of_trials(values: list[torch.Tensor], function: object) -> torch.Tensor:
        return torch.stack([function(v) if len(v) else v.new_tensor(torch.nan) for v in values])  # type: ignore[operator]

    def save(self) -> tuple[dict[str, float | None], dict[str, Any]]:
        """Write series.npz, trials.csv and the figure, close the events; returns means over trials, and no alarms.

        series.npz holds, sampled T times from the start on (sums since the start where it says so),
        `time` [T] (s), `rewards` [T, B] (sum), `dopamine` [T, B] (uM), `mean_weight` [T, B] (mV), and
        `firing_rate` [T - 1, B, G] (Hz) between samples. With a watched synapse `chosen_weight`, `max_weight`
        [T, B] (mV) and `coincidences` [T, B] (sum); mean and maximum are those of all other plastic synapses,
        whose `histogram` [B, 40] at the end has the `edges` [41]. With stimuli `presented` and `response`
        [T, B, K] (sums). `groups` [G] are names, `trials` [B] numbers.
        """
        folder = self.folder
        network, task = self.simulation.network, self.simulation.situation
        trials = network.draws.trials.cpu().numpy()
        edges = np.linspace(0.0, self._most(), BINS + 1)
        others = [weight.cpu().numpy() for weight in self._others()]
        series = {key: np.stack(values) for key, values in self._samples.items()}
        series |= {"edges": edges, "histogram": np.stack([np.histogram(w, edges)[0] for w in others])}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, groups=np.array(self.groups), trials=trials, **series)  # type: ignore[arg-type]
        write(folder / "series.npz", buffer.getvalue())
        row: dict[str, np.ndarray] = {"rewards": series["rewards"][-1], "mean_weight": series["mean_weight"][-1]}
        if task.coincidence is not None:
            row |= self._reinforcement(series, others)
            write(folder / "reinforcement.png", draw_reinforcement(series))
        if task.stimuli is not None:
            row |= _conditioning(series, task.stimuli.rewarded)
            write(folder / "conditioning.png", draw_conditioning(series, task.stimuli.rewarded, task.stimuli.window))
        write(folder / "trials.csv", _table(trials, row))
        if self.writer is not None:
            self.writer.close()
        return {key: float(values.mean()) for key, values in row.items() if np.isfinite(values).all()}, {}

    def _most(self) -> float:
        """Largest weight that a plastic synapse may have (mV)."""
        rules = [projection.rule for projection in self.simulation.network.projections.values()]
        return max((rule.weight_max for rule in rules if rule is not None), default=1.0)

    def _reinforcement(self, series: dict[str, np.ndarray], others: list[np.ndarray]) -> dict[str, np.ndarray]:
        """The watched synapse at the end, when it first came within 5 % of the top, and its rivals there."""
        top = 0.95 * self._most()
        reached = series["chosen_weight"] >= top
        return {
            "chosen_weight": series["chosen_weight"][-1],
            "seconds_to_top": np.where(reached.any(0), series["time"][reached.argmax(0)], np.nan),
            "others_at_top": np.array([(weight >= top).mean() if len(weight) else 0.0 for weight in others]),
        }


def _conditioning(series: dict[str, np.ndarray], rewarded: int) -> dict[str, np.ndarray]:
    """Mean responses (spikes) to the rewarded and the other stimuli in the first and the last quarter, [B] each."""
    result = {}
    for name, response in zip(("first", "last"), quarters(series), strict=True):
        result[f"response_{name}"] = response[:, rewarded]
        result[f"others_{name}"] = np.nanmean(np.delete(response, rewarded, 1), 1)
    return result


def _table(trials: np.ndarray, columns: dict[str, np.ndarray]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["trial", *columns])
    for k, trial in enumerate(trials.tolist()):
        table.writerow([trial, *("" if np.isnan(values[k]) else f"{values[k]:.6g}" for values in columns.values())])
    return text.getvalue()
