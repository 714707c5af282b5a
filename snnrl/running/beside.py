"""Work on a copy of a simulation, while the simulation goes on: recording takes no time of its own."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from snnrl.simulation import Simulation

LARGEST = 1 << 26  # bytes of a state that are copied


class Beside:
    """A thread that works on a copy of a simulation. A large state, or one on a GPU, is worked on where it is instead.

    Attributes:
        copy: what the work reads: the simulation as it was when the work began, though its tensors be written to.
    """

    def __init__(self, simulation: Simulation[Any]) -> None:
        size = sum(tensor.nbytes for tensor in changing(simulation))
        self._thread = ThreadPoolExecutor(1) if simulation.network.device.type == "cpu" and size <= LARGEST else None
        self.copy = copy.deepcopy(simulation) if self._thread else simulation
        both = zip(changing(self.copy), changing(simulation), strict=True) if self._thread else ()
        self._copied = [(mine.numpy(), theirs.numpy()) for mine, theirs in both]
        self._work: Future[None] | None = None

    def begin(self, work: Callable[[], None]) -> None:
        """Start some work, once the work before has ended; raises what that has raised."""
        self.wait()
        if self._thread is None:
            work()
            return
        for mine, theirs in self._copied:
            np.copyto(mine, theirs)
        self._work = self._thread.submit(torch.no_grad()(work))

    def wait(self) -> None:
        """Until the work has ended; raises what it has raised."""
        if self._work is not None:
            work, self._work = self._work, None
            work.result()

    def __enter__(self) -> Beside:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is not None:
            self._thread.shutdown()


def changing(simulation: Simulation[Any]) -> Iterator[Tensor]:
    """All tensors that may change while a simulation runs, each once."""
    network, situation = simulation.network, simulation.situation
    yield from (network.neurons.packed, network.neurons.last_spike)
    yield from (network.synapses.weight, network.synapses.eligibility)
    yield from network.buffers(recurse=False)
    for modulator in network.modulators.values():
        yield from modulator.buffers()
    assert isinstance(situation, nn.Module)
    yield from situation.buffers()
