"""The last moments of the first trial before each picture: where its robot was, and who fired."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from snnrl.model.network import Network

PATH, STEP, SPIKES = 10_000, 400, 1000  # ms: of path, between its points, of spikes


def spacing(tick: int) -> tuple[int, int]:
    """How many ticks (of that many ms) there are between two points of the path, and how many points it has."""
    step = max(1, STEP // tick)
    return step, max(1, PATH // (step * tick))


class Film:
    """Keeps what the next picture will show.

    Args:
        network: whose spikes are filmed.
        tick: ms.
        state: what `state_dict` gave.

    Attributes:
        path: [n, 2], cm.
        fired: bool [ms, N], up to the last ms.
    """

    def __init__(self, network: Network, tick: int, state: Mapping[str, Any] | None = None) -> None:
        self.network, self.tick = network, tick
        self.path = torch.zeros(0, 2, dtype=torch.float64)
        self.fired = torch.zeros(0, network.size, dtype=torch.bool)
        if state is not None:
            self.path, self.fired = state["path"], state["fired"]

    def state_dict(self) -> dict[str, Tensor]:
        return {"path": self.path, "fired": self.fired}

    def raster(self, ticks: int) -> Tensor:
        """Where an engine notes who fires in the next ticks, bool [ms, 1, N]."""
        return torch.zeros(ticks * self.tick, 1, self.network.size, dtype=torch.bool, device=self.network.device)

    def keep(self, raster: Tensor) -> None:
        """Who has fired in the ticks that have just been run."""
        self.fired = torch.cat([self.fired, raster[:, 0].cpu()])[-max(SPIKES, self.tick) :]

    def keep_position(self, position: Tensor) -> None:
        """Where the robot is, [2], cm."""
        _, points = spacing(self.tick)
        self.path = torch.cat([self.path, position[None].cpu()])[-points:]

    def forget(self) -> None:
        """Begin anew: what is run now is not filmed."""
        self.path, self.fired = self.path[:0], self.fired[:0]
