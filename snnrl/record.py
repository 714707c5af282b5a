"""What is kept of a run: series in memory, TensorBoard events as it goes, files at the end."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from snnrl.loop import Simulation
from snnrl.synapses import Projection
from snnrl.world import TOUCHES


def write(path: Path, content: bytes | str) -> None:
    """Write a file as a whole: a reader sees the old one or the new one."""
    unfinished = path.with_name(path.name + ".unfinished")
    unfinished.write_bytes(content.encode() if isinstance(content, str) else content)
    os.replace(unfinished, path)


class Recorder:
    """Samples a simulation.

    Args:
        simulation: what is sampled; projections with a role are followed.
        events: folder for TensorBoard events; None writes none.
    """

    def __init__(self, simulation: Simulation, events: Path | None) -> None:
        self.simulation = simulation
        self.writer = None if events is None else SummaryWriter(str(events))
        self.followed = [p for p in simulation.network.projections.values() if p.role]
        self.groups = list(simulation.network.groups)
        self._sizes = torch.tensor([g.size for g in simulation.network.groups.values()])
        self._samples: dict[str, list[np.ndarray]] = {}
        self._before = self._counts()
        self._written = 0  # last whole second with events

    def _counts(self) -> tuple[float, torch.Tensor, torch.Tensor]:
        network, world = self.simulation.network, self.simulation.world
        return int(network.time) / 1000.0, world.touches.cpu().clone(), network.spike_count.cpu().clone()

    def sample(self) -> float:
        """Take one sample; returns the food collection rate (items/s) of the time since the last one."""
        network = self.simulation.network
        seconds, touches, spikes = self._counts()
        then, touches_then, spikes_then = self._before
        self._before = seconds, touches, spikes
        sample = {
            "time": torch.tensor(seconds),
            "collection_rate": (touches[:, 0] - touches_then[:, 0]) / (seconds - then),
            "firing_rate": (spikes - spikes_then) / (self._sizes * (seconds - then)),
            "weight": torch.stack([p.mean_weight() for p in self.followed], 1),
            "eligibility": torch.stack([p.mean_eligibility() for p in self.followed], 1),
            "position": self.simulation.world.position,
            "heading": self.simulation.world.heading,
            "nearest_item": self.simulation.world.nearest_item(),
        }
        if network.dopamine is not None:
            sample["dopamine"] = network.dopamine.level
        for key, values in sample.items():
            self._samples.setdefault(key, []).append(values.float().cpu().numpy())
        if self.writer is not None and int(seconds) > self._written:
            self._written = int(seconds)
            self._write_events(self._written)
        return float(sample["collection_rate"].mean())

    def _write_events(self, seconds: int) -> None:
        assert self.writer is not None
        latest = {key: values[-1] for key, values in self._samples.items()}
        self.writer.add_scalar("collection rate, items per s/food", latest["collection_rate"].mean(), seconds)
        if "dopamine" in latest:
            self.writer.add_scalar("dopamine/level, uM", latest["dopamine"].mean(), seconds)
        for k, projection in enumerate(self.followed):
            self.writer.add_scalar(f"weight, mV/{projection.name}", latest["weight"][:, k].mean(), seconds)
        for k, group in enumerate(self.groups):
            self.writer.add_scalar(f"firing rate, Hz/{group}", latest["firing_rate"][:, k].mean(), seconds)

    def save(self, folder: Path, correct: torch.Tensor | None) -> None:
        """Write series.npz, weights.npz and trials.csv, and close the events.

        series.npz holds `time` [T] (s), `collection_rate` [T, B] (items/s), `weight` and `eligibility`
        [T, B, P] (means, absent synapses as zeros), `firing_rate` [T, B, G] (Hz), `dopamine` [T, B] (uM),
        the robot's `position` [T, B, 2] (cm) and `heading` [T, B] (rad), its distance to the `nearest_item`
        [T, B] (cm), and the names `projections` [P], `groups` [G] and the numbers `trials` [B].
        weights.npz holds for each of `projections` NAME its weights at the end, [B, n_pre, n_post] (mV),
        nan where there is no synapse.
        """
        series = {key: np.stack(values) for key, values in self._samples.items()}
        trials = self.simulation.network.draws.trials.cpu().numpy()
        names = {
            "projections": np.array([p.name for p in self.followed]),
            "groups": np.array(self.groups),
            "trials": trials,
        }
        write(folder / "series.npz", _npz({**series, **names}))
        write(folder / "weights.npz", _npz({p.name: _dense(p) for p in self.followed}))
        write(folder / "trials.csv", self._table(trials, correct))
        if self.writer is not None:
            self.writer.close()

    def _table(self, trials: np.ndarray, correct: torch.Tensor | None) -> str:
        text = io.StringIO()
        weights = {p.name: p.mean_weight().tolist() for p in self.followed}
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["trial", *TOUCHES, "correct", *weights])
        touches = self.simulation.world.touches.tolist()
        for k, trial in enumerate(trials.tolist()):
            learnt = "" if correct is None else int(correct[k])
            row = [f"{values[k]:.6g}" for values in weights.values()]
            table.writerow([trial, *touches[k], learnt, *row])
        return text.getvalue()


def _npz(arrays: dict[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _dense(projection: Projection) -> np.ndarray:
    weights = np.full(projection.shape, np.nan, np.float32)
    at = (projection.trial.cpu(), projection.pre_index.cpu(), projection.post_index.cpu())
    weights[at] = projection.weight.float().cpu().numpy()
    return weights


def write_json(path: Path, content: dict[str, Any]) -> None:
    """A dictionary as readable JSON; refuses NaN and infinities."""
    write(path, json.dumps(content, indent=2, allow_nan=False) + "\n")
