"""Projections: sparse synapses between two groups, and the plasticity that acts on them."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from snnrl.model.elementary import exp, exp_of


@dataclass(frozen=True)
class Plasticity:
    """Dopamine-modulated, nearest-neighbour STDP (thesis 3.7; Izhikevich 2007).

    Two spikes of one ms are a pair at no distance, which `simultaneous` says what to make of. Where it
    potentiates (the thesis), it is the only pair of that ms. Where it depresses (Izhikevich 2007: the
    presynaptic spike is still on its way), the postsynaptic spike also pairs with the presynaptic neuron's
    latest earlier one.

    Attributes:
        potentiation, depression: A+ and A-, the change of eligibility by one pair at no distance.
        tau_plus, tau_minus: width of the two halves of the window (ms).
        tau_eligibility: decay of the eligibility (ms).
        weight_max: plastic weights stay in [0, weight_max] (mV).
        simultaneous: what a pair of spikes of one ms does, "potentiates" or "depresses".
    """

    potentiation: float
    depression: float
    tau_plus: float
    tau_minus: float
    tau_eligibility: float
    weight_max: float
    simultaneous: str = "potentiates"
    decay: float = field(init=False)  # of the eligibility in one ms

    def __post_init__(self) -> None:
        object.__setattr__(self, "decay", exp_of(-1.0 / self.tau_eligibility))


def stdp(elapsed: Tensor, amplitude: float, tau: float, dtype: torch.dtype) -> Tensor:
    """Weight of a pair of spikes `elapsed` ms apart: one half of the window (thesis 3.7), same shape."""
    return (amplitude * exp(elapsed.double() / -tau)).to(dtype)


class Projection(nn.Module):
    """The synapses from one group to another, of every trial.

    Synapses are stored flat, ordered by trial, then presynaptic, then postsynaptic neuron; trials have
    different numbers of them. `S` is the number over all trials.

    Args:
        name: the projection's name in its network.
        pre, post: the two groups' names.
        connected: which pairs are joined, bool [B, n_pre, n_post].
        weight: weight of every pair (mV), [B, n_pre, n_post]; values of absent pairs are not used.
        plastic: whether the network's plasticity acts on it.
        delay: whole milliseconds, at least 1.
        role: what it does for the behaviour (for example `food_attraction`); "" if nothing in particular.

    Buffers:
        weight: [S], mV. eligibility: [S].
        trial, pre_index, post_index: int64 [S], the ends of each synapse, counted within trial and group.
        count: int64 [B], synapses of each trial.
    """

    weight: Tensor
    eligibility: Tensor
    trial: Tensor
    pre_index: Tensor
    post_index: Tensor
    count: Tensor

    def __init__(
        self,
        name: str,
        pre: str,
        post: str,
        connected: Tensor,
        weight: Tensor,
        plastic: bool = False,
        delay: int = 1,
        role: str = "",
    ) -> None:
        super().__init__()
        self.name, self.pre, self.post, self.role = name, pre, post, role
        self.plastic, self.delay = plastic, delay
        self.shape = tuple(connected.shape)
        trial, pre_index, post_index = connected.nonzero(as_tuple=True)
        self.register_buffer("weight", weight[connected])
        self.register_buffer("eligibility", torch.zeros_like(self.weight))
        self.register_buffer("trial", trial)
        self.register_buffer("pre_index", pre_index)
        self.register_buffer("post_index", post_index)
        self.register_buffer("count", connected.sum((1, 2)), persistent=False)

    def matrix(self, values: Tensor | None = None) -> Tensor:
        """Weights (or other values [S]) as a sparse COO tensor [B, n_pre, n_post]; a copy, not a view."""
        indices = torch.stack([self.trial, self.pre_index, self.post_index])
        values = self.weight if values is None else values
        return torch.sparse_coo_tensor(indices, values.clone(), self.shape, check_invariants=True, is_coalesced=True)

    def mean_weight(self) -> Tensor:
        """Mean weight of each trial (mV), [B] float64, absent synapses counted as zeros (thesis 4.2)."""
        return self._mean(self.weight)

    def mean_eligibility(self) -> Tensor:
        """Mean eligibility of each trial, [B] float64, absent synapses counted as zeros."""
        return self._mean(self.eligibility)

    def _mean(self, values: Tensor) -> Tensor:
        return self.total(values) / (self.shape[1] * self.shape[2])

    def total(self, values: Tensor) -> Tensor:
        """Sum of values [S] over the synapses of each trial, [B] float64."""
        return torch.segment_reduce(values.double(), "sum", lengths=self.count, unsafe=True)

    def extra_repr(self) -> str:
        kind = "plastic" if self.plastic else "fixed"
        return f"{self.pre} -> {self.post}, {len(self.weight)} synapses in {self.shape[0]} trials, {kind}"
