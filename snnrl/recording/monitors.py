"""Monitors: single neurons, synapses and modulators of chosen trials, as often as every millisecond.

Probes (`snnrl.recording.probes`) are means over whole groups and projections, at the samples of a run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from snnrl.engines import Engine, make_engine
from snnrl.engines.watched import WatchedEngine
from snnrl.errors import ConfigError
from snnrl.model.network import Network
from snnrl.model.synapses import Projection
from snnrl.recording.datasets import of_monitor
from snnrl.schema import MonitorConfig
from snnrl.simulation import Simulation

if TYPE_CHECKING:
    from xarray import Dataset

SPIKES = "spikes"
OF_A_PROJECTION, OF_A_MODULATOR = ("weight", "eligibility"), ("level",)


class Monitor:
    """What has been seen of one group, projection or modulator of a network.

    Args:
        network: what is looked at.
        of: the name of a group, a projection or a modulator in it.
        quantities: of a group, the state of its neurons' model (v, u) and `spikes`; of a projection, `weight` and
            `eligibility`; of a modulator, `level`.
        neurons: of a group. pre, post: of a projection, the neurons that its synapses come from, and go to. All are
            counted within their group; None is all of it.
        trials: their numbers; None is all of the network's.
        every: ms between two looks. Spikes are always all there.
        name: of the monitor; None is that of what it looks at.
        key: what an error's line puts before the argument's name.

    Attributes:
        axes: what a look's values are along: the trials, and then the neurons, or pre and post, by their numbers.

    Raises:
        ConfigError: something is not there.
    """

    def __init__(
        self,
        network: Network,
        of: str,
        quantities: str | Sequence[str],
        *,
        neurons: Sequence[int] | None = None,
        pre: Sequence[int] | None = None,
        post: Sequence[int] | None = None,
        trials: Sequence[int] | None = None,
        every: int = 1,
        name: str | None = None,
        key: str = "",
    ) -> None:
        self.network, self.of, self.name = network, of, of if name is None else name
        self.quantities = (quantities,) if isinstance(quantities, str) else tuple(quantities)
        if every < 1:
            raise ConfigError(f"{key}every", every, "must be at least 1 ms")
        ends, allowed = _described(network, of, key)
        for quantity in self.quantities or ("",):
            if quantity not in allowed:
                raise ConfigError(f"{key}quantities", quantity, f"of {of} must be one of {', '.join(allowed)}")
        for end, given in (("neurons", neurons), ("pre", pre), ("post", post)):
            if given is not None and end not in ends:
                raise ConfigError(f"{key}{end}", list(given), f"{of} has {', '.join(ends) or 'none'}")
        numbers = network.draws.trials.tolist()
        chosen = {"trials": _among(f"{key}trials", trials, numbers)}
        for end, given in (("neurons", neurons), ("pre", pre), ("post", post)):
            if end in ends:
                chosen[end] = _among(f"{key}{end}", given, range(ends[end]))
        self.axes: dict[str, np.ndarray] = {end: np.array(values) for end, values in chosen.items()}
        self._rows = [numbers.index(trial) for trial in chosen["trials"]]
        self._sampled = [quantity for quantity in self.quantities if quantity != SPIKES]
        self._every = every
        self._times: list[int] = []
        self._samples: dict[str, list[np.ndarray]] = {quantity: [] for quantity in self._sampled}
        self._spikes: list[np.ndarray] = []

    @property
    def every(self) -> int:
        """ms between two looks; 0 where spikes are all that is wanted."""
        return self._every if self._sampled else 0

    @property
    def rows(self) -> int:
        """How many of the first trials' spikes are wanted; see `snnrl.engines.watched.Watcher`."""
        return max(self._rows) + 1 if SPIKES in self.quantities else 0

    @property
    def time(self) -> np.ndarray:
        """Of the looks, int64 [T]: how many ms of the trial were over."""
        return np.array(self._times, np.int64)

    def __getitem__(self, quantity: str) -> np.ndarray:
        """All values of a quantity, [T, ...] along `axes`; nan where a projection has no synapse.

        Of `spikes`, int64 [n, 3], in order: the ms in which each was, counted from 0, its trial's number, its neuron.
        """
        if quantity == SPIKES and SPIKES in self.quantities:
            return np.concatenate([np.zeros((0, 3), np.int64), *self._spikes])
        return np.array(self._samples[quantity]).reshape(-1, *self._shape)

    def look(self, network: Network) -> None:
        """Read all quantities but the spikes."""
        self._times.append(int(network.time))
        for quantity, values in self._samples.items():
            values.append(self._read(quantity).cpu().numpy().copy())

    def _read(self, quantity: str) -> Tensor:
        network = self.network
        if self.of in network.groups:
            return getattr(network.groups[self.of], quantity)[self._rows][:, self.axes["neurons"]]
        if self.of in network.modulators:
            return network.modulators[self.of].level[self._rows]
        values = getattr(network.projections[self.of], quantity)
        at, place = self._synapses
        seen = values.new_full(self._shape, torch.nan)
        seen.view(-1)[place] = values[at]
        return seen

    @cached_property
    def _synapses(self) -> tuple[Tensor, Tensor]:
        return _joined(self.network.projections[self.of], self._rows, self.axes["pre"], self.axes["post"])

    @property
    def _shape(self) -> list[int]:
        """Of what a look sees of a quantity."""
        return [len(values) for values in self.axes.values()]

    def see(self, fired: Tensor, start: int) -> None:
        """Note the spikes; see `snnrl.engines.watched.Watcher`."""
        group = self.network.groups[self.of]
        time, trial, neuron = fired[:, self._rows][:, :, group.start + self.axes["neurons"]].nonzero().cpu().numpy().T
        self._spikes.append(np.stack([start + time, self.axes["trials"][trial], self.axes["neurons"][neuron]], 1))

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything by name: what it is `of`, `time`, the axes and the quantities."""
        seen = {quantity: self[quantity] for quantity in self.quantities}
        return {"of": np.array(self.of), "time": self.time, **self.axes, **seen}

    def dataset(self) -> Dataset:
        """Everything as an xarray dataset; see `snnrl.recording.datasets.of_monitor`.

        Raises:
            ImportError: xarray is not installed.
        """
        return of_monitor(self.arrays())

    def size(self, ms: float) -> float:
        """Bytes that so many ms take, without spikes."""
        values = math.prod(self._shape) * len(self._sampled)
        return ms / self._every * values * self.network.pending.element_size()

    def state_dict(self) -> dict[str, Tensor]:
        """All that has been seen."""
        return {key: torch.from_numpy(self[key]) for key in self.quantities} | {"time": torch.from_numpy(self.time)}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Go on from what `state_dict` gave."""
        self._times = state["time"].tolist()
        self._samples = {quantity: list(state[quantity].numpy()) for quantity in self._sampled}
        self._spikes = [state[SPIKES].numpy()] if SPIKES in self.quantities else []


def _described(network: Network, of: str, key: str) -> tuple[dict[str, int], Sequence[str]]:
    """How many neurons there are at each end of a part of the network, and its quantities."""
    found: list[tuple[dict[str, int], Sequence[str]]] = []
    if of in network.groups:
        group = network.groups[of]
        found.append(({"neurons": group.size}, (*group.model.state, SPIKES)))
    if of in network.projections:
        _, pre, post = network.projections[of].shape
        found.append(({"pre": pre, "post": post}, OF_A_PROJECTION))
    if of in network.modulators:
        found.append(({}, OF_A_MODULATOR))
    if not found:
        names = ", ".join((*network.groups, *network.projections, *network.modulators))
        raise ConfigError(f"{key}of", of, f"must be a group, projection or modulator: {names}")
    if len(found) > 1:
        raise ConfigError(f"{key}of", of, "is the name of more than one part of the network")
    return found[0]


def _among(key: str, given: Sequence[int] | None, allowed: Sequence[int]) -> list[int]:
    """Numbers that must be different ones of those allowed; None is all."""
    chosen = list(allowed) if given is None else list(given)
    for number in chosen:
        if number not in allowed:
            raise ConfigError(key, number, f"must be among {allowed[0]} to {allowed[-1]}")
    if len(set(chosen)) < len(chosen) or not chosen:
        raise ConfigError(key, chosen, "must name at least one, each once")
    return chosen


def _joined(projection: Projection, rows: Sequence[int], pre: np.ndarray, post: np.ndarray) -> tuple[Tensor, Tensor]:
    """The synapses between some neurons in some rows of the batch, and where they stand in [b, pre, post], laid out."""
    places = []
    ends = projection.trial, projection.pre_index, projection.post_index
    wanted: tuple[Any, ...] = rows, pre, post
    for end, size, chosen in zip(ends, projection.shape, wanted, strict=True):
        place = torch.full((size,), -1, device=end.device)
        place[torch.as_tensor(chosen, device=end.device)] = torch.arange(len(chosen), device=end.device)
        places.append(place[end])
    at = (torch.stack(places) >= 0).all(0).nonzero()[:, 0]
    row, first, second = (place[at] for place in places)
    return at, (row * len(pre) + first) * len(post) + second


def record(network: Network, of: str, quantities: str | Sequence[str], **chosen: Any) -> Monitor:
    """A monitor, to be given to `run_network` or `run_simulation`; see `Monitor`."""
    return Monitor(network, of, quantities, **chosen)


def monitors_of(network: Network, configs: Mapping[str, MonitorConfig]) -> list[Monitor]:
    """Those that a run's `record.monitors` asks for.

    Raises:
        ConfigError: one of them asks for something that is not there.
    """
    return [
        Monitor(network, **{**vars(config), "name": name, "key": f"record.monitors.{name}."})
        for name, config in configs.items()
    ]


def run_network(
    network: Network,
    current: Tensor,
    monitors: Sequence[Monitor] = (),
    *,
    engine: str | Engine = "auto",
    sign: Tensor | None = None,
    reward: Tensor | None = None,
) -> list[Monitor]:
    """Drive a network with a current [T, B, N] for T ms; returns the monitors, which have seen it.

    Args:
        engine: or its name, for `snnrl.make_engine`. sign, reward: see `Network.run`.

    Raises:
        ConfigError: there is no such engine, or it cannot run this network here.
        ValueError: a monitor is of another network.
    """
    _watched(network, monitors, engine).run_network(network, current, sign, None, reward)
    return list(monitors)


def run_simulation(
    simulation: Simulation[Any], seconds: float, monitors: Sequence[Monitor] = (), *, engine: str | Engine = "auto"
) -> list[Monitor]:
    """Let a robot, or a task, go on for so many simulated s, rounded to whole control ticks; returns the monitors.

    The monitors change nothing in what happens. Raises as `run_network`.
    """
    watched = _watched(simulation.network, monitors, engine)
    simulation.run(watched, round(1000 * seconds / simulation.tick))
    return list(monitors)


def _watched(network: Network, monitors: Sequence[Monitor], engine: str | Engine) -> WatchedEngine:
    for monitor in monitors:
        if monitor.network is not network:
            raise ValueError(f"monitors: {monitor.name} is of another network than the one that is run")
    return WatchedEngine(make_engine(engine, str(network.device)) if isinstance(engine, str) else engine, monitors)
