"""What is kept of a run: series in memory, TensorBoard events as it goes, files at the end."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from snnrl.configuration.schema import FOOD as SCORED
from snnrl.configuration.schema import RecordConfig
from snnrl.engines import Engine
from snnrl.files import write
from snnrl.model.synapses import Projection
from snnrl.recording.alarms import POINTS, Alarms
from snnrl.recording.board import ALARMS, CORRECT, DOPAMINE, ELIGIBILITY, FIRING, FOOD, OF_ROLE, RATE, WEIGHT, Board
from snnrl.recording.film import PATH, Film
from snnrl.simulation import Simulation

SHOWN = ("collection_rate", "firing_rate", "weight", "eligibility", "dopamine")  # of the samples, as scalars


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


def ticks_of(seconds: float | None, tick: int) -> int:
    """Whole ticks (ms each) of an interval, at least one; 0 for none."""
    return max(1, round(1000 * seconds / tick)) if seconds else 0


class Recorder:
    """Samples a simulation, watches over it and shows it.

    Args:
        simulation: what is sampled; projections with a role are followed.
        config: what is kept and how often.
        ticks: of the whole run.
        folder: of the run.
        learnt: which trials have learnt by now, bool [B]; None where nothing says so.
        choices: the run's row in TensorBoard's table of hyperparameters.
        state: what `state_dict` gave of the recorder of the run's part so far; see also `keep_events`.
    """

    def __init__(
        self,
        simulation: Simulation,
        config: RecordConfig,
        ticks: int,
        folder: Path,
        learnt: Callable[[], torch.Tensor] | None = None,
        choices: Mapping[str, str | float] | None = None,
        state: Mapping[str, Any] | None = None,
    ) -> None:
        self.simulation, self.folder, self.learnt = simulation, folder, learnt
        self.followed = [p for p in simulation.network.projections.values() if p.role]
        self.groups = list(simulation.network.groups)
        self._sizes = torch.tensor([g.size for g in simulation.network.groups.values()])
        self._samples: dict[str, list[np.ndarray]] = {}
        self._before = self._counts()
        self._apart = max(1, round(config.alarms.synchronised_over / (POINTS * config.every)))  # samples
        part: Mapping[str, Any] = state or {}
        if state is not None:
            self._samples = {key: list(values.numpy()) for key, values in state["samples"].items()}
            self._before = state["before"]
        self.alarms = Alarms(config.alarms, simulation, [p.role for p in self.followed], part.get("alarms"))
        self.board = Board(folder) if config.tensorboard else None
        every = (config.histograms, config.pictures) if self.board else (0.0, 0.0)
        self.histograms, pictures = (ticks_of(seconds, simulation.situation.coding.tick) for seconds in every)
        self.film = Film(simulation, pictures, ticks, part.get("film"))
        if self.board and state is None:
            self.board.begin(self.followed, choices or {}, learnt is not None)

    def state_dict(self) -> dict[str, Any]:
        """All that has been sampled, and how many bytes of events are on the disk for good."""
        return {
            "samples": {key: torch.from_numpy(np.stack(values)) for key, values in self._samples.items()},
            "before": self._before,
            "alarms": self.alarms.state_dict(),
            "film": self.film.state_dict(),
            "events": self.board.flush() if self.board else 0,
        }

    def _counts(self) -> dict[str, torch.Tensor]:
        """What only ever grows: ms, food, spikes, and the sum of dopamine's level over all ms."""
        network, dopamine = self.simulation.network, self.simulation.network.dopamine
        food = self.simulation.situation.world.count(SCORED)
        counts = {"ms": network.time, "food": food, "spikes": network.spike_count}
        if dopamine is not None:
            counts["dopamine"] = dopamine.total
        return {key: values.cpu().clone() for key, values in counts.items()}

    def most(self, done: int) -> int:
        """How many ticks may follow at once after `done`."""
        return min(self.film.most(done), self.histograms - done % self.histograms if self.histograms else 1 << 60)

    def advance(self, engine: Engine, done: int, ticks: int) -> None:
        """Run the next ticks, at most as many as `most` says."""
        self.film.run(engine, done, ticks)

    def sample(self) -> tuple[str, list[str]]:
        """Take one sample.

        Returns the food collection rate of the time since the last one in words, and a line for each kind of
        alarm that has occurred for the first time.
        """
        network = self.simulation.network
        counts = self._counts()
        change = {key: values - self._before[key] for key, values in counts.items()}
        seconds, span = int(counts["ms"]) / 1000.0, int(change["ms"]) / 1000.0
        step, last = round(seconds), round(int(self._before["ms"]) / 1000.0)
        self._before = counts
        sample = {
            "time": torch.tensor(seconds),
            "collection_rate": change["food"] / span,
            "firing_rate": change["spikes"] / (self._sizes * span),
            "weight": self._of_each(Projection.mean_weight),
            "eligibility": self._of_each(Projection.mean_eligibility),
            "position": self.simulation.situation.world.position,
            "heading": self.simulation.situation.world.heading,
            "nearest_item": self.simulation.situation.world.nearest_item(),
        }
        if network.dopamine is not None:
            sample["dopamine"] = change["dopamine"] / int(change["ms"])
        for key, values in sample.items():
            self._samples.setdefault(key, []).append(values.float().cpu().numpy().copy())
        weight = torch.from_numpy(np.stack(self._samples["weight"][:: -self._apart][:POINTS][::-1]))
        rung = {kind: self.alarms.explain(kind) for kind in self.alarms.check(weight)}
        if self.board is not None:
            for kind, line in rung.items():
                self.board.note(f"alarm: {kind}", line, step)
            if step > last:
                self.board.scalars(self._scalars(), step)
        return f"{float(sample['collection_rate'].mean()):.2f} food/s", list(rung.values())

    def _of_each(self, mean: Callable[[Projection], torch.Tensor]) -> torch.Tensor:
        """[B, P]"""
        if not self.followed:
            return torch.zeros(self.simulation.trials, 0)
        return torch.stack([mean(p) for p in self.followed], 1)

    def _scalars(self) -> dict[str, float]:
        """Means over trials of the latest sample, by their tags."""
        latest = {key: values[-1].mean(0).tolist() for key, values in self._samples.items() if key in SHOWN}
        values = {
            FOOD: float(self.simulation.situation.world.count(SCORED).double().mean()),
            RATE: latest["collection_rate"],
        }
        if self.learnt is not None:
            values[CORRECT] = float(self.learnt().double().mean())
        if "dopamine" in latest:
            values[DOPAMINE] = latest["dopamine"]
        roles: dict[str, list[float]] = {}
        for projection, weight, eligibility in zip(self.followed, latest["weight"], latest["eligibility"], strict=True):
            values[f"{WEIGHT}/{projection.name}"] = weight
            values[f"{ELIGIBILITY}/{projection.name}"] = eligibility
            roles.setdefault(projection.role, []).append(weight)
        values |= {f"{OF_ROLE}/{role}": sum(means) / len(means) for role, means in roles.items()}
        values |= {f"{FIRING}/{name}": rate for name, rate in zip(self.groups, latest["firing_rate"], strict=True)}
        return values | {f"{ALARMS}/{kind}": count for kind, count in self.alarms.counts().items()}

    def show(self, done: int) -> None:
        """Write the histograms and pictures that are due after so many ticks."""
        network, world = self.simulation.network, self.simulation.situation.world
        seconds = int(network.time) / 1000.0
        step = round(seconds)
        if self.board is None:
            return
        if self.histograms and done % self.histograms == 0:
            self.board.histograms(self.followed, step)
        if self.film.due(done):
            from snnrl.drawing import pictures  # matplotlib takes a while

            fired = self.film.fired.numpy()
            shown = {
                f"last {PATH // 1000} s in the arena": pictures.arena(world, self.film.path.numpy()),
                "last spikes": pictures.spike_raster(network, fired, seconds - len(fired) / 1000.0),
                "weights": pictures.weight_matrix(network, self.followed or list(network.projections.values())),
            }
            for tag, drawn in shown.items():
                if drawn is not None:
                    trial = int(network.draws.trials[0])
                    self.board.picture(f"trial {trial}/{tag}", pictures.pixels(drawn), step)

    def save(self) -> tuple[dict[str, float | None], dict[str, Any]]:
        """Write series.npz, weights.npz and trials.csv, and close the events; returns means over trials, and alarms.

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
        folder, learnt = self.folder, None if self.learnt is None else self.learnt()
        write(folder / "series.npz", _npz({**series, **names}))
        write(folder / "weights.npz", _npz({p.name: _dense(p) for p in self.followed}))
        write(folder / "trials.csv", self._table(trials, learnt))
        if self.board is not None:
            self.board.end()
        food = self.simulation.situation.world.count(SCORED).double()
        results = {
            "food_mean": float(food.mean()),
            "food_sd": float(food.std()) if len(food) > 1 else None,
            "correct_fraction": None if learnt is None else float(learnt.double().mean()),
        }
        return results, self.alarms.summary()

    def _table(self, trials: np.ndarray, learnt: torch.Tensor | None) -> str:
        text = io.StringIO()
        weights = {p.name: p.mean_weight().tolist() for p in self.followed}
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["trial", *self.simulation.situation.world.kinds.names, "correct", *weights])
        touches = self.simulation.situation.world.touches.tolist()
        for k, trial in enumerate(trials.tolist()):
            row = [f"{values[k]:.6g}" for values in weights.values()]
            table.writerow([trial, *touches[k], "" if learnt is None else int(learnt[k]), *row])
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
