"""The same network as one would first write it in PyTorch: matrices of all pairs of neurons, computed in every ms."""

from __future__ import annotations

import math
from collections import deque

import torch
from torch import Tensor

from snnrl.model.network import Network


class DenseNetwork:
    """A network at ms 0 whose delays are all 1 ms, as matrices [B, N, N] from presynaptic to postsynaptic neuron."""

    def __init__(self, network: Network) -> None:
        assert network.dopamine is not None
        assert int(network.time) == 0
        table = network.synapses
        assert bool((table.delay == 1).all())
        self.rule, self.dopamine, self.gain = network.learning()[0].rule, network.dopamine, network.synaptic_gain
        self.source = network.groups[self.dopamine.sources["count"]].span
        neurons = network.neurons
        self.v, self.u = neurons.v.clone(), neurons.u.clone()
        self.a, self.b, self.c, self.d = neurons.a, neurons.b, neurons.c, neurons.d
        size = network.size
        at = (table.trial, table.pre % size, table.post % size)
        self.at_plastic = tuple(index[: table.plastic] for index in at)
        self.weight = self.v.new_zeros(network.trials, size, size)
        self.weight[at] = table.weight
        self.plastic = torch.zeros_like(self.weight, dtype=torch.bool)
        self.plastic[self.at_plastic] = True
        self.eligibility = torch.zeros_like(self.weight)
        self.arriving, self.last_pre, self.last_post = (torch.zeros_like(self.v) for _ in range(3))
        self.level = self.dopamine.level.clone()
        self.released = deque([torch.zeros_like(self.level)] * self.dopamine.delay)
        self.sets = []
        for homeostasis in network.homeostasis.values():
            member = torch.zeros_like(self.plastic)
            for name in homeostasis.projections:
                projection = network.projections[name]
                member[:, network.groups[projection.pre].span, network.groups[projection.post].span] = True
            self.sets.append(
                (member & self.plastic, homeostasis.limit * network.set_size(homeostasis), homeostasis.step)
            )

    def step(self, current: Tensor) -> Tensor:
        """One ms with the current [B, N] from outside and of the background; who fired, bool [B, N]."""
        rule, dopamine = self.rule, self.dopamine
        current = self.arriving + current
        for _ in range(2):
            self.v = self.v + 0.5 * (0.04 * self.v * self.v + 5.0 * self.v + 140.0 - self.u + current)
        self.u = self.u + self.a * (self.b * self.v - self.u)
        fired = self.v >= 30.0
        self.v = torch.where(fired, self.c, self.v)
        self.u = torch.where(fired, self.u + self.d, self.u)

        count = self.released.popleft()
        self.released.append(fired[:, self.source].sum(1).to(self.v.dtype))
        self.level = dopamine.baseline + (self.level - dopamine.baseline) * math.exp(-1.0 / dopamine.tau)
        self.level = self.level + dopamine.values["release"] * count * (count > dopamine.values["threshold"])

        change = self._pairs(fired)
        self.eligibility = self.eligibility * math.exp(-1.0 / rule.tau_eligibility) + change
        learnt = (self.weight + self.eligibility * self.level[:, None, None]).clamp(0.0, rule.weight_max)
        self.weight = torch.where(self.plastic, learnt, self.weight)
        for member, limit, step in self.sets:
            high = (self.weight * member).sum((1, 2)) > limit
            lower = member & high[:, None, None]
            self.weight = torch.where(lower, (self.weight - step).clamp_min(0.0), self.weight)

        self.arriving = self.gain * torch.einsum("bi,bij->bj", fired.to(self.v.dtype), self.weight)
        return fired

    def _pairs(self, fired: Tensor) -> Tensor:
        """What the pairs that this ms's spikes complete add to the eligibility; the traces are brought up to date."""
        rule, before, after = self.rule, fired[:, :, None], fired[:, None, :]
        earlier, self.last_post = (
            trace * math.exp(-1.0 / tau)
            for trace, tau in ((self.last_pre, rule.tau_plus), (self.last_post, rule.tau_minus))
        )
        self.last_pre = torch.where(fired, rule.potentiation, earlier)
        latest = torch.where(fired, rule.depression, self.last_post)
        if rule.simultaneous == "depresses":
            rise = torch.where(after, earlier[:, :, None], 0.0)
            change = rise - torch.where(before, latest[:, None, :], 0.0)
        else:
            loss = torch.where(before, -self.last_post[:, None, :], 0.0)
            change = torch.where(after, self.last_pre[:, :, None], loss)
        self.last_post = latest
        return change
