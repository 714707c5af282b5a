"""What is kept of a run: series in memory, TensorBoard events as it goes, files at the end."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter

from snnrl.files import sync, write
from snnrl.loop import Simulation
from snnrl.synapses import Projection
from snnrl.world import TOUCHES


def keep_events(folder: Path, size: int) -> None:
    """Keep the first `size` bytes of a folder's TensorBoard events, in one file that sorts before any later one.

    Killed at any point and called again, it does the same: the bytes that are kept stay in front.
    """
    files = sorted(folder.glob("events.out.tfevents.*"))
    kept = folder / "events.out.tfevents.0000000000.kept"
    if size:
        write(kept, b"".join(file.read_bytes() for file in files)[:size])
    for file in files:
        if file != kept or not size:
            file.unlink()


class Recorder:
    """Samples a simulation.

    Args:
        simulation: what is sampled; projections with a role are followed.
        events: folder for TensorBoard events; None writes none.
        state: what `state_dict` gave of the recorder of the run's part so far; see also `keep_events`.
    """

    def __init__(self, simulation: Simulation, events: Path | None, state: Mapping[str, Any] | None = None) -> None:
        self.simulation, self.events = simulation, events
        self.writer = None if events is None else SummaryWriter(str(events))
        self.followed = [p for p in simulation.network.projections.values() if p.role]
        self.groups = list(simulation.network.groups)
        self._sizes = torch.tensor([g.size for g in simulation.network.groups.values()])
        self._samples: dict[str, list[np.ndarray]] = {}
        self._before = self._counts()
        if state is not None:
            self._samples = {key: list(values.numpy()) for key, values in state["samples"].items()}
            self._before = state["before"]

    def state_dict(self) -> dict[str, Any]:
        """All that has been sampled, and how many bytes of events are on the disk for good."""
        size = 0
        if self.writer is not None and self.events is not None:
            self.writer.flush()
            for file in self.events.glob("events.out.tfevents.*"):
                sync(file)
                size += file.stat().st_size
        samples = {key: torch.from_numpy(np.stack(values)) for key, values in self._samples.items()}
        return {"samples": samples, "before": self._before, "events": size}

    def _counts(self) -> dict[str, torch.Tensor]:
        """What only ever grows: ms, touches, spikes, and the sum of dopamine's level over all ms."""
        network, dopamine = self.simulation.network, self.simulation.network.dopamine
        counts = {"ms": network.time, "touches": self.simulation.world.touches, "spikes": network.spike_count}
        if dopamine is not None:
            counts["dopamine"] = dopamine.total
        return {key: values.cpu().clone() for key, values in counts.items()}

    def sample(self) -> float:
        """Take one sample; returns the food collection rate (items/s) of the time since the last one."""
        network = self.simulation.network
        counts = self._counts()
        change = {key: values - self._before[key] for key, values in counts.items()}
        seconds, span = int(counts["ms"]) / 1000.0, int(change["ms"]) / 1000.0
        then, self._before = int(self._before["ms"]) / 1000.0, counts
        sample = {
            "time": torch.tensor(seconds),
            "collection_rate": change["touches"][:, 0] / span,
            "firing_rate": change["spikes"] / (self._sizes * span),
            "weight": torch.stack([p.mean_weight() for p in self.followed], 1),
            "eligibility": torch.stack([p.mean_eligibility() for p in self.followed], 1),
            "position": self.simulation.world.position,
            "heading": self.simulation.world.heading,
            "nearest_item": self.simulation.world.nearest_item(),
        }
        if network.dopamine is not None:
            sample["dopamine"] = change["dopamine"] / int(change["ms"])
        for key, values in sample.items():
            self._samples.setdefault(key, []).append(values.float().cpu().numpy().copy())
        if self.writer is not None and int(seconds) > int(then):
            self._write_events(int(seconds))
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
        [T, B] (cm), and the names `projections` [P], `groups` [G] and the numbers `trials` [B]. Rates and
        dopamine are means over the time since the sample before, the others values at the sample.
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
            self.writer.flush()  # unlike close, says so if an event could not be written
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
