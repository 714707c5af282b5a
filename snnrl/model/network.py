"""The network: groups and projections, stepped together one millisecond at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from snnrl.model.draws import Draws, stream
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.modulators import Dopamine
from snnrl.model.neurons import NeuronGroup, izhikevich
from snnrl.model.synapses import Plasticity, Projection, stdp


@dataclass
class NeuronTable:
    """All neurons side by side, [B, N]; the groups' buffers are views of these tensors."""

    v: Tensor
    u: Tensor
    a: Tensor
    b: Tensor
    c: Tensor
    d: Tensor
    last_spike: Tensor


@dataclass
class SynapseTable:
    """All synapses end to end, [S], plastic projections first; the projections' buffers are views.

    `trial` is the trial's place in the batch. `pre` and `post` count through all neurons of all trials
    (trial * N + neuron).
    """

    weight: Tensor
    eligibility: Tensor
    trial: Tensor
    pre: Tensor
    post: Tensor
    delay: Tensor
    plastic: int  # how many of them, from the front, are plastic


class Network(nn.Module):
    """Spiking network of a batch of independent trials, without autograd.

    Args:
        groups: in the order in which their neurons are numbered.
        projections: between those groups.
        draws: owner of the background noise; its trials are the batch.
        synaptic_gain: current per mV of weight that a spike delivers.
        plasticity: the rule of the plastic projections.
        dopamine: the modulator; None leaves plastic weights unchanged.
        homeostasis: named sets of projections and their dampening.

    A subclass may have another `membrane`, a function with the arguments and results of `izhikevich`.

    Buffers besides the modules':
        time: int64 scalar, the ms that the next step computes.
        pending: [B, L, N], current on its way; slot `t % L` arrives at t (L is the longest delay).
        spike_count: int64 [B, G], spikes of each group since the start.
    """

    groups: Mapping[str, NeuronGroup]
    projections: Mapping[str, Projection]
    time: Tensor
    pending: Tensor
    spike_count: Tensor
    neurons: NeuronTable
    synapses: SynapseTable
    membrane = staticmethod(izhikevich)

    def __init__(
        self,
        groups: Iterable[NeuronGroup],
        projections: Iterable[Projection],
        draws: Draws,
        synaptic_gain: float,
        plasticity: Plasticity,
        dopamine: Dopamine | None = None,
        homeostasis: Mapping[str, Homeostasis] | None = None,
    ) -> None:
        super().__init__()
        by_name = nn.ModuleDict({group.name: group for group in groups})
        self.groups = cast("Mapping[str, NeuronGroup]", by_name)
        ordered = sorted(projections, key=lambda projection: not projection.plastic)
        by_name = nn.ModuleDict({projection.name: projection for projection in ordered})
        self.projections = cast("Mapping[str, Projection]", by_name)
        self.plasticity, self.dopamine, self.synaptic_gain = plasticity, dopamine, synaptic_gain
        self.homeostasis = dict(homeostasis or {})
        self.draws = draws
        self.size = 0
        for group in self.groups.values():
            group.start, self.size = self.size, self.size + group.size
        self.trials = len(draws.trials)
        self.slots = max((projection.delay for projection in ordered), default=1)
        like = next(iter(self.groups.values())).v
        self.register_buffer("time", torch.zeros((), dtype=torch.int64, device=like.device))
        self.register_buffer("pending", like.new_zeros(self.trials, self.slots, self.size))
        count = torch.zeros(self.trials, len(self.groups), dtype=torch.int64, device=like.device)
        self.register_buffer("spike_count", count)
        self._pack()

    @property
    def dtype(self) -> torch.dtype:
        return self.pending.dtype

    @property
    def device(self) -> torch.device:
        return self.pending.device

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Network:
        super()._apply(fn, recurse)
        self.draws = self.draws.to(self.device)
        self._pack()
        return self

    def _pack(self) -> None:
        """Lay all groups and all projections in shared tensors, of which their buffers become views."""
        groups = list(self.groups.values())
        projections = list(self.projections.values())
        keys = list(NeuronTable.__annotations__)
        self.neurons = NeuronTable(**{key: torch.cat([getattr(g, key) for g in groups], 1) for key in keys})
        for group in groups:
            for key in keys:
                setattr(group, key, getattr(self.neurons, key)[:, group.span])

        def join(parts: list[Tensor], dtype: torch.dtype) -> Tensor:
            return torch.cat([torch.empty(0, dtype=dtype, device=self.device), *parts])

        def neuron(p: Projection, end: str, index: Tensor) -> Tensor:
            return p.trial * self.size + self.groups[end].start + index

        self.synapses = SynapseTable(
            weight=join([p.weight for p in projections], self.dtype),
            eligibility=join([p.eligibility for p in projections], self.dtype),
            trial=join([p.trial for p in projections], torch.int64),
            pre=join([neuron(p, p.pre, p.pre_index) for p in projections], torch.int64),
            post=join([neuron(p, p.post, p.post_index) for p in projections], torch.int64),
            delay=join([torch.full_like(p.trial, p.delay) for p in projections], torch.int64),
            plastic=sum(len(p.weight) for p in projections if p.plastic),
        )
        start = 0
        for projection in projections:
            span = slice(start, start + len(projection.weight))
            projection.weight = self.synapses.weight[span]
            projection.eligibility = self.synapses.eligibility[span]
            start = span.stop
        sizes = [torch.full((group.size,), k, device=self.device) for k, group in enumerate(groups)]
        self._group_of = torch.cat(sizes)
        self._pack_sets(projections)

    def _pack_sets(self, projections: list[Projection]) -> None:
        """Homeostatic sets as tensors: each plastic synapse's set, and each set's limit and step."""
        sets = list(self.homeostasis.values())
        # trial * K + the place of the set; B * K for a synapse that is in none
        none = torch.full_like(self.synapses.trial[: self.synapses.plastic], self.trials * len(sets))
        start = 0
        for projection in projections:
            span = slice(start, start + len(projection.weight))
            for k, homeostasis in enumerate(sets):
                if projection.plastic and projection.name in homeostasis.projections:
                    none[span] = projection.trial * len(sets) + k
            start = span.stop
        self._set_of = none
        limits = torch.tensor([s.limit for s in sets], dtype=torch.float64, device=self.device)
        self.set_limit = self._set_sizes() * limits
        self._set_step = torch.tensor([s.step for s in sets], dtype=self.dtype, device=self.device)

    def _set_sizes(self) -> Tensor:
        """How many pairs (or synapses) each homeostatic set's mean is over: float64 [B, K]."""
        sizes = torch.zeros(self.trials, len(self.homeostasis), dtype=torch.float64, device=self.device)
        for k, homeostasis in enumerate(self.homeostasis.values()):
            for name in homeostasis.projections:
                projection = self.projections[name]
                if homeostasis.count_absent:
                    sizes[:, k] += projection.shape[1] * projection.shape[2]
                else:
                    sizes[:, k] += projection.count
        return sizes

    def background(self, times: Tensor) -> Tensor:
        """Constant and noisy background current at int64 times [T], [T, B, N]."""
        current = self.pending.new_zeros(len(times), self.trials, self.size)
        for group in self.groups.values():
            if group.noise:
                noise = self.draws.uniform(stream("background", group.name), times, group.size).to(self.dtype)
                current[:, :, group.span] = group.current + group.noise * (2.0 * noise - 1.0)
            else:
                current[:, :, group.span] = group.current
        return current

    def run(
        self,
        injected: Tensor,
        sign: Tensor | None = None,
        raster: Tensor | None = None,
        reward: Tensor | None = None,
    ) -> None:
        """Step through as many ms as `injected` has rows, in plain torch (the reference).

        Args:
            injected: current from outside, [T, B, N].
            sign: [B] of the network's dtype, -1 where dopamine is released with a negative sign; +1 if None.
            raster: bool [T, b, N] to be filled with who fired in the first b trials.
            reward: dopamine released from outside (uM), [T, B]; none if None.

        Raises:
            ValueError: for a reward to a network without dopamine.
        """
        self.check_reward(reward)
        sign = torch.ones_like(self.pending[:, 0, 0]) if sign is None else sign
        steps = len(injected)
        background = self.background(self.time + torch.arange(steps, device=self.device))
        for k in range(steps):
            fired = self.step(background[k], injected[k], sign, None if reward is None else reward[k])
            if raster is not None:
                raster[k] = fired[: raster.shape[1]]

    def check_reward(self, reward: Tensor | None) -> None:
        """Raise ValueError for a reward that nothing could take up."""
        if reward is not None and self.dopamine is None:
            raise ValueError("reward: needs a network with dopamine")

    def step(self, background: Tensor, injected: Tensor, sign: Tensor, reward: Tensor | None = None) -> Tensor:
        """One millisecond; the one definition of the order of events inside it. Returns who fired, bool [B, N].

        1. Input: what arrives now, plus the background and the injected current.
        2. Neurons: membrane, recovery, spike and reset.
        3. Dopamine: decay, the release of earlier spikes, and the reward from outside.
        4. Eligibility: decay, and the pairs that this ms's spikes complete.
        5. Weights: eligibility times dopamine, clipped.
        6. Homeostasis: sets whose mean is too high are lowered.
        7. Sending: this ms's spikes leave with the weights as they are now.
        """
        neurons, time = self.neurons, self.time
        slot = (time % self.slots).view(1)
        current = self.pending.index_select(1, slot)[:, 0] + background + injected
        self.pending.index_fill_(1, slot, 0.0)
        v, u, fired = self.membrane(neurons.v, neurons.u, current, neurons.a, neurons.b, neurons.c, neurons.d)
        neurons.v.copy_(v)
        neurons.u.copy_(u)
        self.spike_count.index_add_(1, self._group_of, fired.long())
        self.learn(fired, sign, reward)
        self._send(fired)
        time += 1
        return fired

    def learn(self, fired: Tensor, sign: Tensor, reward: Tensor | None = None) -> None:
        """Steps 3 to 6 of this millisecond, for whoever fired in it, bool [B, N]; the rest as in `step`."""
        neurons = self.neurons
        earlier = neurons.last_spike.clone()
        neurons.last_spike.copy_(torch.where(fired, self.time, neurons.last_spike))
        if self.dopamine is None:
            return
        source = slice(0) if self.dopamine.source is None else self.groups[self.dopamine.source].span
        self.dopamine.step(fired[:, source].sum(1), sign, self.time, reward)
        if self.synapses.plastic:
            self._change_eligibility(fired, earlier)
            self._change_weights(self.dopamine.level)
            if self.homeostasis:
                self._dampen()

    def _change_eligibility(self, fired: Tensor, earlier: Tensor) -> None:
        """Step 4; `earlier` [B, N] holds last spikes without those of this ms."""
        rule, table = self.plasticity, self.synapses
        pre, post = table.pre[: table.plastic], table.post[: table.plastic]
        eligibility = table.eligibility[: table.plastic]
        depresses = rule.simultaneous == "depresses"
        latest = self.neurons.last_spike
        elapsed = self.time - (earlier if depresses else latest)
        gain = stdp(elapsed, rule.potentiation, rule.tau_plus, self.dtype).view(-1)
        loss = stdp(self.time - latest, rule.depression, rule.tau_minus, self.dtype).view(-1)
        fired = fired.view(-1)
        rise, fall = torch.where(fired[post], gain[pre], 0.0), torch.where(fired[pre], -loss[post], 0.0)
        change = rise + fall if depresses else torch.where(fired[post], rise, fall)
        eligibility.mul_(rule.decay).add_(change)

    def _change_weights(self, level: Tensor) -> None:
        table = self.synapses
        weight, eligibility = table.weight[: table.plastic], table.eligibility[: table.plastic]
        weight.add_(eligibility * level[table.trial[: table.plastic]])
        weight.clamp_(0.0, self.plasticity.weight_max)

    def _dampen(self) -> None:
        weight = self.synapses.weight[: self.synapses.plastic]
        total = torch.zeros(self.set_limit.numel() + 1, dtype=torch.float64, device=self.device)
        total.index_add_(0, self._set_of, weight.double())
        over = (total[:-1].view_as(self.set_limit) > self.set_limit) * self._set_step
        lowered = torch.cat([over.view(-1), over.new_zeros(1)])[self._set_of]
        weight.copy_(torch.where(lowered > 0, (weight - lowered).clamp_min(0.0), weight))

    def _send(self, fired: Tensor) -> None:
        table = self.synapses
        row = table.trial * (self.slots - 1) * self.size + (self.time + table.delay) % self.slots * self.size
        sent = table.weight * self.synaptic_gain * fired.view(-1)[table.pre]
        self.pending.view(-1).index_add_(0, table.post + row, sent)
