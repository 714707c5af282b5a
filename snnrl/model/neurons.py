"""Izhikevich neurons in named groups."""

from __future__ import annotations

import torch
from torch import Tensor, nn

NEVER = -(1 << 40)  # last-spike time (ms) of a neuron that has not fired
SQUARE, LINEAR, CONSTANT = 0.04, 5.0, 140.0  # of dv/dt = 0.04 v^2 + 5 v + 140 - u + I
PEAK = 30.0  # mV; at or above it a neuron has fired (Izhikevich 2003)


def izhikevich(
    v: Tensor, u: Tensor, current: Tensor, a: Tensor, b: Tensor, c: Tensor, d: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """One millisecond: two half steps of v (mV), one step of u, then the reset (thesis 3.3; Izhikevich 2003).

    Returns v, u and which neurons fired, all of the inputs' shape.
    """
    v = v + 0.5 * (SQUARE * v * v + LINEAR * v + CONSTANT - u + current)
    v = v + 0.5 * (SQUARE * v * v + LINEAR * v + CONSTANT - u + current)
    u = u + a * (b * v - u)
    fired = v >= PEAK
    return torch.where(fired, c, v), torch.where(fired, u + d, u), fired


class NeuronGroup(nn.Module):
    """State and parameters of one population in every trial; all buffers are [B, n].

    Args:
        name: the group's name in its network.
        a, b, c, d: Izhikevich parameters, [B, n] of the network's dtype.
        v: initial membrane potential (mV); the recovery starts at b v.
        current, noise: a constant background current, and the half width of a uniform one drawn per
            neuron and ms.
    """

    v: Tensor
    u: Tensor
    a: Tensor
    b: Tensor
    c: Tensor
    d: Tensor
    last_spike: Tensor

    def __init__(
        self,
        name: str,
        a: Tensor,
        b: Tensor,
        c: Tensor,
        d: Tensor,
        v: float,
        current: float = 0.0,
        noise: float = 0.0,
    ) -> None:
        super().__init__()
        self.name, self.current, self.noise = name, current, noise
        self.size = a.shape[1]
        self.start = 0  # position of the first neuron in the network; set when the group joins one
        for key, value in {"a": a, "b": b, "c": c, "d": d, "v": torch.full_like(a, v), "u": b * v}.items():
            self.register_buffer(key, value)
        self.register_buffer("last_spike", torch.full(a.shape, NEVER, dtype=torch.int64, device=a.device))

    @property
    def span(self) -> slice:
        """Where the group's neurons stand among all neurons of the network."""
        return slice(self.start, self.start + self.size)

    def extra_repr(self) -> str:
        return f"{self.size} neurons"
