"""Neuron models, and neurons in named groups."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from snnrl.model.draws import BELL_SPREAD, BITS

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


def izhikevich_start(v: Tensor, a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """The recovery that goes with an initial v."""
    return v, b * v


def time_cell(
    v: Tensor, left: Tensor, current: Tensor, threshold: float, onset: Tensor, width: float, period: float
) -> tuple[Tensor, Tensor, Tensor]:
    """One ms of a cell that fires in a time field after an input (time cells: MacDonald et al. 2011, Neuron 71:737).

    An input above `threshold` brings v to -onset (mV) and opens the field, which closes `width` ms after the onset; a
    later one does so anew. While ms are `left`, v climbs by 1 mV a ms; at 0 the cell fires, and v falls by `period`.

    Returns v, left and which cells fired, all of the inputs' shape.
    """
    started = current > threshold
    v = torch.where(started, -onset, torch.where(left > 0.0, v + 1.0, v))
    left = torch.where(started, onset + width, torch.where(left > 1.0, left - 1.0, 0.0))
    fired = (v >= 0.0) & (left > 0.0)
    return torch.where(fired, v - period, v), left, fired


def uniform_noise(draw: Tensor, current: float, noise: float) -> Tensor:
    """Background current from a number uniform in [0, 1): `current`, and up to `noise` more or less."""
    return current + noise * (2.0 * draw - 1.0)


def gaussian_noise(current: Tensor, draw: Tensor, scale: float) -> Tensor:
    """A current and a nearly Gaussian one: `scale` times a draw of `snnrl.model.draws.bell`."""
    return current + scale * draw


def kicked(current: Tensor, draw: Tensor, below: int, kick: float) -> Tensor:
    """A current, and a kick besides where a 24-bit draw is below a threshold."""
    return torch.where(draw < below, current + kick, current)


@dataclass(frozen=True)
class NeuronModel:
    """How a neuron goes through one millisecond.

    Attributes:
        step: an elementwise function `step(v, *other_state, current, *parameters)` that returns the new state and
            whether the neuron fired; what its arguments are called names the state and the parameters.
        start: `start(v, *parameters)`, the state that goes with an initial v (mV); None if all the rest is 0.
    """

    step: Callable[..., tuple[Tensor, ...]]
    start: Callable[..., tuple[Tensor, ...]] | None = None
    state: tuple[str, ...] = field(init=False)
    parameters: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        names = list(inspect.signature(self.step).parameters)
        if "current" not in names or names[0] != "v":
            name = getattr(self.step, "__name__", self.step)
            raise ValueError(f"{name}({', '.join(names)}): must be NAME(v, ..., current, ...), state and parameters")
        at = names.index("current")
        object.__setattr__(self, "state", tuple(names[:at]))
        object.__setattr__(self, "parameters", tuple(names[at + 1 :]))

    @property
    def columns(self) -> tuple[str, ...]:
        return (*self.state, *self.parameters)

    def at_start(self, v: Tensor, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The initial state by name."""
        if self.start is None:
            return dict.fromkeys(self.state, torch.zeros_like(v)) | {"v": v}
        return dict(zip(self.state, self.start(v, *(parameters[name] for name in self.parameters)), strict=True))


IZHIKEVICH = NeuronModel(izhikevich, izhikevich_start)
TIME_CELL = NeuronModel(time_cell)


class NeuronGroup(nn.Module):
    """State and parameters of one population in every trial; all buffers are [B, n] and called as in its model.

    Args:
        name: the group's name in its network.
        model: of its neurons.
        parameters: of the model, each [B, n] of the network's dtype.
        v: initial membrane potential (mV).
        current: a constant background current; all others are drawn per neuron and ms, and added to it.
        noise: half width of a uniform one. gaussian: standard deviation of a Gaussian one.
        kick, kick_rate: a current in single ms, and how often these are (Hz).

    Raises:
        ValueError: a parameter of the model is missing, or one is given that it does not have.
    """

    v: Tensor
    last_spike: Tensor

    def __init__(
        self,
        name: str,
        model: NeuronModel,
        parameters: Mapping[str, Tensor],
        v: float,
        current: float = 0.0,
        noise: float = 0.0,
        gaussian: float = 0.0,
        kick: float = 0.0,
        kick_rate: float = 0.0,
    ) -> None:
        super().__init__()
        if set(parameters) != set(model.parameters):
            raise ValueError(f"{name}: has {', '.join(parameters)}, must have {', '.join(model.parameters)}")
        self.name, self.model, self.current, self.noise = name, model, current, noise
        self.gaussian, self.kick, self.kick_rate = gaussian, kick, kick_rate
        like = next(iter(parameters.values()))
        self.size = like.shape[1]
        self.start = 0  # position of the first neuron in the network; set when the group joins one
        for key, value in (model.at_start(torch.full_like(like, v), parameters) | dict(parameters)).items():
            self.register_buffer(key, value)
        self.register_buffer("last_spike", torch.full(like.shape, NEVER, dtype=torch.int64, device=like.device))

    @property
    def span(self) -> slice:
        """Where the group's neurons stand among all neurons of the network."""
        return slice(self.start, self.start + self.size)

    @property
    def gaussian_scale(self) -> float:
        """The Gaussian current of one unit of `snnrl.model.draws.bell`."""
        return self.gaussian / BELL_SPREAD

    @property
    def kicked_below(self) -> int:
        """The 24-bit draws that bring a kick are those below this."""
        return round(self.kick_rate / 1000.0 * (1 << BITS)) if self.kick else 0

    @property
    def restless(self) -> bool:
        """Whether its background is not the same in every ms."""
        return bool(self.noise or self.gaussian or self.kicked_below)

    def extra_repr(self) -> str:
        return f"{self.size} neurons"
