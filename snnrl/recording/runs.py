"""Run folders, read back: what the recorder has written of a run that is complete."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml


@dataclass(frozen=True)
class Run:
    """What a finished run has left; see `snnrl.recording.recorder.Recorder.save` for the arrays."""

    folder: Path

    @cached_property
    def summary(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "summary.json").read_text()))

    @cached_property
    def config(self) -> dict[str, Any]:
        return dict(yaml.safe_load((self.folder / "config.yaml").read_text()))

    @cached_property
    def series(self) -> dict[str, np.ndarray]:
        with np.load(self.folder / "series.npz") as arrays:
            return dict(arrays)

    @cached_property
    def weights(self) -> dict[str, np.ndarray]:
        """At the end; none of a task."""
        if not (self.folder / "weights.npz").exists():
            return {}
        with np.load(self.folder / "weights.npz") as arrays:
            return dict(arrays)

    @cached_property
    def monitors(self) -> dict[str, dict[str, np.ndarray]]:
        """What each monitor of the run has seen, by its name; see `snnrl.recording.monitors.Monitor.arrays`."""
        found: dict[str, dict[str, np.ndarray]] = {}
        if (self.folder / "monitors.npz").exists():
            with np.load(self.folder / "monitors.npz") as arrays:
                for name, values in arrays.items():
                    monitor, _, key = name.rpartition("/")
                    found.setdefault(monitor, {})[key] = values
        return found

    @cached_property
    def trials(self) -> dict[str, np.ndarray]:
        """The columns of trials.csv as float arrays; what is empty is nan."""
        rows = list(csv.DictReader((self.folder / "trials.csv").open()))
        return {key: np.array([float(row[key] or "nan") for row in rows]) for key in rows[0]}

    @property
    def robot(self) -> str:
        return str(self.summary["robot"])

    @property
    def time(self) -> np.ndarray:
        """Of the samples, [T], s."""
        return self.series["time"].astype(float)

    def of_projection(self, kind: str, projection: str) -> np.ndarray:
        """`weight` or `eligibility` of a projection, [T, B]."""
        return self.series[kind][:, :, self.series["projections"].tolist().index(projection)]

    def firing_rate(self, group: str) -> np.ndarray:
        """[T, B], Hz."""
        return self.series["firing_rate"][:, :, self.series["groups"].tolist().index(group)]

    def rate(self, start: float, end: float) -> np.ndarray:
        """Items that each trial collected per s from `start` to `end` (s), [B]."""
        edges = np.concatenate([[0.0], self.time])
        inside = (edges[:-1] >= start - 0.05) & (edges[1:] <= end + 0.05)
        spans = np.diff(edges)[inside]
        return np.asarray((self.series["collection_rate"][inside] * spans[:, None]).sum(0) / spans.sum())
