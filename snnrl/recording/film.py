"""The last moments of the first trial before each picture: where its robot was, and who fired."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from snnrl.engines import Engine
from snnrl.simulation import Simulation

PATH, STEP, SPIKES = 10_000, 400, 1000  # ms: of path, between its points, of spikes


class Film:
    """Runs a simulation, and keeps what its next picture will show.

    Args:
        every: ticks from picture to picture; 0 is no pictures.
        end: tick of the last one.
        state: what `state_dict` gave.

    Attributes:
        path: [n, 2], cm.
        fired: bool [ms, N], up to the last ms.
    """

    def __init__(self, simulation: Simulation, every: int, end: int, state: Mapping[str, Any] | None = None) -> None:
        self.simulation, self.every, self.end = simulation, every, end
        tick = simulation.situation.coding.tick
        self._step = max(1, STEP // tick)
        self._length = self._step * max(1, PATH // (self._step * tick))
        self.path = torch.zeros(0, 2, dtype=torch.float64)
        self.fired = torch.zeros(0, simulation.network.size, dtype=torch.bool)
        if state is not None:
            self.path, self.fired = state["path"], state["fired"]

    def state_dict(self) -> dict[str, Tensor]:
        return {"path": self.path, "fired": self.fired}

    def due(self, done: int) -> bool:
        """Whether there is a picture after `done` ticks."""
        return self.every > 0 and (done % self.every == 0 or done == self.end)

    def _left(self, done: int) -> int:
        return min(self.end, (done // self.every + 1) * self.every) - done

    def most(self, done: int) -> int:
        """How many ticks may follow at once after `done`."""
        if not self.every:
            return self.end - done
        left = self._left(done)
        return left - self._length if left > self._length else left % self._step or self._step

    def run(self, engine: Engine, done: int, ticks: int) -> None:
        """The next ticks, at most as many as `most` says."""
        network = self.simulation.network
        if not self.every or self._left(done) > self._length:
            self.path, self.fired = self.path[:0], self.fired[:0]
            self.simulation.run(engine, ticks)
            return
        raster = torch.zeros(
            ticks * self.simulation.situation.coding.tick, 1, network.size, dtype=torch.bool, device=network.device
        )
        self.simulation.run(engine, ticks, raster)
        self.fired = torch.cat([self.fired, raster[:, 0].cpu()])[-max(SPIKES, self.simulation.situation.coding.tick) :]
        if (self._left(done) - ticks) % self._step == 0:
            self.path = torch.cat([self.path, self.simulation.situation.world.position[:1].cpu()])[-self._length :]
