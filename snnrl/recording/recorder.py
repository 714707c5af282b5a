"""What is kept of a run: series in memory, what loggers are told as it goes, files at the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from snnrl.files import csv_of, npz_of, write
from snnrl.model.synapses import Projection
from snnrl.recording.alarms import POINTS, Alarms
from snnrl.recording.film import PATH, Film
from snnrl.recording.kept import Kept
from snnrl.recording.logger import About, Logger
from snnrl.recording.monitors import Monitor
from snnrl.recording.probes import Moment, Probe, counts, followed
from snnrl.recording.shown import ALARMS, charts, histograms, means, roles, spread
from snnrl.schema import RecordConfig
from snnrl.simulation import Simulation


class Recorder:
    """Samples a simulation by its probes, watches over it and shows it.

    Args:
        simulation: what is sampled.
        kept: what is read at every sample, and at the end.
        config: thresholds of alarms.
        about: what loggers are told of the run, but for its metrics and charts.
        state: what `state_dict` gave of the recorder of the run's part so far.
        monitors: see that they see the simulation run; what they have seen is kept with the rest.
        loggers: by their names.

    Attributes:
        film: what the next picture will show.
    """

    def __init__(
        self,
        simulation: Simulation[Any],
        kept: Kept,
        config: RecordConfig,
        about: About,
        state: Mapping[str, Any] | None = None,
        monitors: Sequence[Monitor] = (),
        loggers: Mapping[str, Logger] | None = None,
    ) -> None:
        self.simulation, self.kept, self.folder, self.monitors = simulation, kept, about.folder, monitors
        self.followed = followed(simulation) if kept.watched else []
        part: Mapping[str, Any] = state or {}
        self._samples = {key: list(values.numpy()) for key, values in part.get("samples", {}).items()}
        self._before = part.get("before", counts(simulation))
        self._apart = max(1, round(config.alarms.synchronised_over / (POINTS * config.every)))  # samples
        watched = [projection.role for projection in self.followed]
        self.alarms = Alarms(config.alarms, simulation, watched, part.get("alarms")) if kept.watched else None
        self.film = Film(simulation.network, simulation.tick, part.get("film"))
        for monitor in monitors if state else ():
            monitor.load_state_dict(part["monitors"][monitor.name])
        self.loggers = loggers or {}
        self._begin(about, part.get("loggers", {}))
        if state is None and kept.from_start:
            self._keep(Moment(simulation, {}), [probe for probe in kept.probes if not probe.between])

    def _begin(self, about: About, saved: Mapping[str, int | str]) -> None:
        probes = self.kept.probes
        metrics = [tag for probe in probes if probe.metric for tag in probe.tags(self.simulation)]
        about = replace(about, metrics=metrics, charts=charts(self.simulation, probes, self.followed))
        for name, logger in self.loggers.items():
            logger.begin(about, saved.get(name))

    def state_dict(self) -> dict[str, Any]:
        """All that has been sampled, and what loggers need to go on."""
        return {
            "samples": {key: torch.from_numpy(np.stack(values)) for key, values in self._samples.items()},
            "before": self._before,
            "alarms": None if self.alarms is None else self.alarms.state_dict(),
            "film": self.film.state_dict(),
            "monitors": {monitor.name: monitor.state_dict() for monitor in self.monitors},
            "loggers": {name: logger.flush() for name, logger in self.loggers.items()},
        }

    @property
    def _step(self) -> int:
        """Of loggers, simulated s."""
        return round(self.simulation.seconds)

    def sample(self, shown: bool = True) -> list[str]:
        """Read all probes; `shown`, for loggers too.

        Returns a line for each kind of alarm that has occurred for the first time.
        """
        now, last = counts(self.simulation), round(int(self._before["ms"]) / 1000.0)
        moment = Moment(self.simulation, {key: values - self._before[key] for key, values in now.items()})
        self._before = now
        self._keep(moment, self.kept.probes)
        rung = self._check()
        scalars = self._scalars(moment) if self.loggers and shown and self._step > last else {}
        for logger in self.loggers.values():
            for kind, line in rung.items():
                logger.text(f"alarm: {kind}", line, self._step)
            if scalars:
                logger.scalars(scalars, self._step)
        return list(rung.values())

    def told(self) -> str:
        """What a line of progress tells of the latest sample."""
        probes = [probe for probe in self.kept.probes if probe.told]
        return ", ".join(probe.told.format(self._samples[probe.name][-1].mean()) for probe in probes)

    def _keep(self, moment: Moment, probes: Sequence[Probe]) -> None:
        for probe in probes:
            if probe.series:
                self._samples.setdefault(probe.name, []).append(probe.read(moment).cpu().numpy().copy())

    def _check(self) -> dict[str, str]:
        """The kinds of alarms that have occurred for the first time, and a line about each."""
        if self.alarms is None:
            return {}
        weight = torch.from_numpy(np.stack(self._samples["weight"][:: -self._apart][:POINTS][::-1]))
        return {kind: self.alarms.explain(kind) for kind in self.alarms.check(weight)}

    def _scalars(self, moment: Moment) -> dict[str, float]:
        """Means and spread over trials of the latest sample, by their tags; trials by kind of alarm."""
        values: dict[str, float] = {}
        for probe in self.kept.probes:
            if tags := probe.tags(self.simulation):
                latest = self._samples[probe.name][-1] if probe.series else probe.read(moment).cpu().numpy()
                values |= means(tags, latest)
                values |= spread(probe.tag, latest) if probe.spread else {}
        for tag, places in roles(self.followed).items():
            weight = self._samples["weight"][-1][:, places].mean(1)
            values |= {tag: float(weight.mean()), **spread(tag, weight)}
        alarms = {} if self.alarms is None else self.alarms.counts()
        return values | {f"{ALARMS}/{kind}": count for kind, count in alarms.items()}

    def point(self) -> None:
        """Note where the first trial's robot is, for the next picture."""
        self.film.keep_position(self.simulation.situation.world.position[0])

    def histograms(self) -> None:
        """Show how the weights of all trials are distributed."""
        found = histograms(self.followed) if self.loggers else {}
        for logger in self.loggers.values():
            logger.histograms(found, self._step)

    def picture(self) -> None:
        """Show the first trial: where its robot has been, who has fired, its weights."""
        from snnrl.drawing import pictures  # which need Matplotlib

        network, world, fired = self.simulation.network, self.simulation.situation.world, self.film.fired.numpy()
        shown = {
            f"last {PATH // 1000} s in the arena": pictures.arena(world, self.film.path.numpy(), int(network.time)),
            "last spikes": pictures.spike_raster(network, fired, self.simulation.seconds - len(fired) / 1000.0),
            "weights": pictures.weight_matrix(network, self.followed or list(network.projections.values())),
        }
        for tag, drawn in shown.items():
            if drawn is not None:
                trial = int(network.draws.trials[0])
                for logger in self.loggers.values():
                    logger.figure(f"trial {trial}/{tag}", pictures.pixels(drawn), self._step)

    def save(self) -> tuple[dict[str, float | None], dict[str, Any]]:
        """Write the files of a complete run but its summary, and end the loggers; returns the results, and the alarms.

        series.npz holds for each of the `probes` NAME what it read, [T, ...] (see `snnrl.recording.probes`; without
        the first sample where that is before the first tick and it reads what is between two), the names of the
        `groups` [G] and the numbers of the `trials` [B], and what `Kept.end` adds.
        weights.npz holds for each of the robot's `projections` NAME its weights at the end, [B, n_pre, n_post] (mV),
        nan where there is no synapse.
        monitors.npz, where there are monitors, holds as NAME/KEY what each has seen; see `Monitor.arrays`.
        """
        series = {key: np.stack(values) for key, values in self._samples.items()}
        ending, trials = self.kept.end(series), self.simulation.network.draws.trials.cpu().numpy()
        names = {"groups": np.array(list(self.simulation.network.groups)), "trials": trials}
        write(self.folder / "series.npz", npz_of({**series, **ending.arrays, **names}))
        if self.kept.watched:
            write(self.folder / "weights.npz", npz_of({p.name: _dense(p) for p in self.followed}))
        seen = {f"{m.name}/{key}": values for m in self.monitors for key, values in m.arrays().items()}
        if seen:
            write(self.folder / "monitors.npz", npz_of(seen))
        for name, content in ending.pictures.items():
            write(self.folder / name, content)
        columns = {"trial": trials, **ending.columns}
        rows = zip(*(map(_cell, values.tolist()) for values in columns.values()), strict=True)
        write(self.folder / "trials.csv", csv_of(list(columns), rows))
        for logger in self.loggers.values():
            logger.end()
        return dict(ending.results), {} if self.alarms is None else self.alarms.summary()


def _cell(value: float) -> str:
    """A number as trials.csv has it."""
    return str(value) if isinstance(value, int) else "" if np.isnan(value) else f"{value:.6g}"


def _dense(projection: Projection) -> np.ndarray:
    weights = np.full(projection.shape, np.nan, np.float32)
    at = (projection.trial.cpu(), projection.pre_index.cpu(), projection.post_index.cpu())
    weights[at] = projection.weight.float().cpu().numpy()
    return weights
