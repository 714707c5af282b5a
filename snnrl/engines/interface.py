"""What an engine is, and what it asks of a situation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from snnrl.model.network import Network

Given = Tensor | None  # or left out


class Situation(Protocol):
    """What a network is in, a robot or a task: what drives it, and what its spikes do; a module with its state.

    Attributes:
        tick: ms between two calls of `begin`.
        watches: whether `finish` looks at the spikes.
    """

    @property
    def tick(self) -> int: ...

    @property
    def watches(self) -> bool: ...

    def begin(self, network: Network) -> tuple[Tensor, Tensor | None, Tensor | None]:
        """The current [tick, B, N], the sign [B] and the reward [tick, B] of the coming tick; see `Network.run`."""

    def finish(self, network: Network, fired: Tensor) -> None:
        """Look at who fired in the tick that has just been run, bool [tick, B, N]."""


class Engine(Protocol):
    """What every engine can do; all results are in the modules' tensors afterwards."""

    name: str

    def prepare(self, network: Network, situation: Situation, compiling: Callable[[], None]) -> None:
        """Have all that `run` needs, without running: what takes time once comes here, not with the first tick.

        `compiling` is called first if that is to compile, which takes seconds; not if it was done earlier.
        """

    def run(self, network: Network, situation: Situation, ticks: int, raster: Tensor | None = None) -> None:
        """Closed loop: `ticks` control ticks; the one definition of their order.

        1. The situation acts on the spikes of the last tick, and gives currents, sign and reward of the coming one.
        2. The network runs for the length of the tick.
        3. The situation sees who fired.

        `raster`, bool [ticks * tick, b, N], is filled with who fired in the first b trials.
        """

    def run_network(
        self, network: Network, injected: Tensor, sign: Given = None, raster: Given = None, reward: Given = None
    ) -> None:
        """Open loop: `Network.run`."""
