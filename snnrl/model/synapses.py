"""Projections: sparse synapses between two groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from snnrl.model.plasticity import Plasticity

DOPAMINE = "dopamine"  # the modulator that a plastic projection listens to unless told otherwise


class Projection(nn.Module):
    """The synapses from one group to another, of every trial.

    Synapses are stored flat, ordered by trial, then presynaptic, then postsynaptic neuron; trials have
    different numbers of them. `S` is the number over all trials.

    Args:
        name: the projection's name in its network.
        pre, post: the two groups' names.
        connected: which pairs are joined, bool [B, n_pre, n_post].
        weight: weight of every pair (mV), [B, n_pre, n_post]; values of absent pairs are not used.
        rule: by which it learns; None if its weights are fixed.
        delay: whole milliseconds, at least 1.
        role: what it does for the behaviour (for example `food_attraction`); "" if nothing in particular.
        listens: the modulators that turn its eligibility into weight, each with a factor on its level; what
            counts is their sum.

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
        rule: Plasticity | None = None,
        delay: int = 1,
        role: str = "",
        listens: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__()
        self.name, self.pre, self.post, self.role = name, pre, post, role
        self.rule, self.delay = rule, delay
        self.listens = {DOPAMINE: 1.0} if listens is None else dict(listens)
        self.shape = tuple(connected.shape)
        trial, pre_index, post_index = connected.nonzero(as_tuple=True)
        self.register_buffer("weight", weight[connected])
        self.register_buffer("eligibility", torch.zeros_like(self.weight))
        self.register_buffer("trial", trial)
        self.register_buffer("pre_index", pre_index)
        self.register_buffer("post_index", post_index)
        self.register_buffer("count", connected.sum((1, 2)), persistent=False)

    @property
    def plastic(self) -> bool:
        """Whether it has a rule by which it learns."""
        return self.rule is not None

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


def totals(projections: Sequence[Projection], values: Sequence[Tensor]) -> Tensor:
    """`Projection.total` of each of P projections of its values [S], all at once, [P, B] float64."""
    lengths = torch.cat([projection.count for projection in projections])
    summed = torch.segment_reduce(torch.cat(list(values)).double(), "sum", lengths=lengths, unsafe=True)
    return summed.view(len(projections), -1)


def means(projections: Sequence[Projection], values: Sequence[Tensor]) -> Tensor:
    """`totals` over all pairs of neurons, absent synapses counted as zeros, [P, B] float64."""
    pairs = [projection.shape[1] * projection.shape[2] for projection in projections]
    return totals(projections, values) / torch.tensor(pairs, device=values[0].device)[:, None]
