"""An engine that lets something look at the network between two milliseconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, cast

import torch
from torch import Tensor, nn

from snnrl.engines.interface import Engine, Given, Situation
from snnrl.model.network import Network

STRETCH = 1000  # ms, about, of which spikes are held at a time in a closed loop


class Watcher(Protocol):
    """What looks at a network.

    Attributes:
        every: ms; it looks whenever the network's time is a multiple of it. Never if that is 0.
        rows: it sees the spikes of so many trials, the first ones; 0 for none.
    """

    @property
    def every(self) -> int: ...

    @property
    def rows(self) -> int: ...

    def look(self, network: Network) -> None:
        """Read what is wanted of the network as it is."""

    def see(self, fired: Tensor, start: int) -> None:
        """Who has fired, bool [T, at least `rows`, N], in the ms from `start` on."""


class WatchedEngine:
    """Another engine, with watchers.

    In a closed loop all results are the other engine's, bit for bit: a tick that a watcher wants to look into is run
    twice, from look to look and then, from the same beginning, as a whole. In an open loop it is run from look to look.
    """

    def __init__(self, engine: Engine, watchers: Sequence[Watcher]) -> None:
        self.engine, self.watchers, self.name = engine, tuple(watchers), engine.name
        self._rows = max((watcher.rows for watcher in watchers), default=0)

    def prepare(self, network: Network, situation: Situation, compiling: Callable[[], None]) -> None:
        """See `snnrl.engines.interface.Engine`."""
        self.engine.prepare(network, situation, compiling)

    def run(self, network: Network, situation: Situation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop; see `snnrl.engines.interface.Engine`."""
        tick = situation.tick
        inside = [w for w in self.watchers if w.every and (w.every % tick or int(network.time) % tick)]
        between = [w for w in self.watchers if w not in inside]
        most = 1 if inside else max(1, STRETCH // tick) if self._rows else ticks
        done = 0
        while done < ticks:
            part = min(ticks - done, most, *(_left(w, network) // tick for w in between if w.every))
            self._look_inside(network, situation, inside)
            given = None if raster is None else raster[done * tick : (done + part) * tick]
            fired, start = self._raster(network, part * tick, given), int(network.time)
            self.engine.run(network, situation, part, fired)
            self._show(fired, start, given)
            _look(network, between)
            done += part

    def _look_inside(self, network: Network, situation: Situation, watchers: Sequence[Watcher]) -> None:
        """Let watchers look at the coming tick; afterwards everything is as it was."""
        if not watchers:
            return
        modules = network, cast("nn.Module", situation)
        before = [{key: values.clone() for key, values in module.state_dict().items()} for module in modules]
        current, sign, reward = situation.begin(network)
        self._run_network(network, current, sign, None, reward, watchers)
        for module, state in zip(modules, before, strict=True):
            module.load_state_dict(state)

    def run_network(
        self, network: Network, injected: Tensor, sign: Given = None, raster: Given = None, reward: Given = None
    ) -> None:
        """Open loop; see `snnrl.engines.interface.Engine`."""
        fired, start = self._raster(network, len(injected), raster), int(network.time)
        self._run_network(network, injected, sign, fired, reward, self.watchers)
        self._show(fired, start, raster)

    def _run_network(
        self,
        network: Network,
        injected: Tensor,
        sign: Given,
        raster: Given,
        reward: Given,
        watchers: Sequence[Watcher],
    ) -> None:
        done = 0
        while done < len(injected):
            part = min(len(injected) - done, *(_left(w, network) for w in watchers if w.every))
            rows = slice(done, done + part)
            fired, given = (None if values is None else values[rows] for values in (raster, reward))
            self.engine.run_network(network, injected[rows], sign, fired, given)
            _look(network, watchers)
            done += part

    def _raster(self, network: Network, steps: int, given: Given) -> Tensor | None:
        """Room for the spikes of all trials that are asked for; None if of none."""
        rows = max(self._rows, 0 if given is None else given.shape[1])
        return network.spike_count.new_zeros((steps, rows, network.size), dtype=torch.bool) if rows else None

    def _show(self, fired: Given, start: int, raster: Given) -> None:
        """Hand out the spikes of the ms from `start` on."""
        if fired is None:
            return
        if raster is not None:
            raster.copy_(fired[:, : raster.shape[1]])
        for watcher in self.watchers:
            if watcher.rows:
                watcher.see(fired, start)


def _left(watcher: Watcher, network: Network) -> int:
    """ms to its next look."""
    return watcher.every - int(network.time) % watcher.every


def _look(network: Network, watchers: Sequence[Watcher]) -> None:
    """Let those look whose time it is."""
    for watcher in watchers:
        if watcher.every and int(network.time) % watcher.every == 0:
            watcher.look(network)
