"""The network: groups and projections, stepped together one millisecond at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, MutableMapping
from dataclasses import dataclass
from functools import reduce
from typing import cast

import torch
from torch import Tensor, nn

from snnrl.model.draws import BELL_DRAWS, Draws, bell, stream
from snnrl.model.homeostasis import Homeostasis, lowered
from snnrl.model.modulators import Modulator
from snnrl.model.neurons import NeuronGroup, NeuronModel, gaussian_noise, kicked, uniform_noise
from snnrl.model.plasticity import Plasticity
from snnrl.model.synapses import DOPAMINE, Projection


class NeuronTable:
    """All neurons side by side, [B, N]; the groups' buffers are views of these tensors.

    Attributes:
        packed: [C, B, N], the state and the parameters of all models in the network; what a neuron's model does not
            have is 0.
        columns: their names. A column is also an attribute of its name.
        last_spike: int64 [B, N], ms.
        parts: neighbouring groups of one model, and where their neurons stand.
    """

    def __init__(self, groups: list[NeuronGroup]) -> None:
        self.columns = list(dict.fromkeys(name for group in groups for name in group.model.columns))
        rows = [
            torch.cat([getattr(g, name) if name in g.model.columns else torch.zeros_like(g.v) for g in groups], 1)
            for name in self.columns
        ]
        self.packed = torch.stack(rows)
        self.last_spike = torch.cat([group.last_spike for group in groups], 1)
        self.parts: list[tuple[NeuronModel, slice]] = []
        for group in groups:
            if self.parts and self.parts[-1][0] == group.model:
                self.parts[-1] = (group.model, slice(self.parts[-1][1].start, group.span.stop))
            else:
                self.parts.append((group.model, group.span))
            for key in group.model.columns:
                setattr(group, key, getattr(self, key)[:, group.span])
            group.last_spike = self.last_spike[:, group.span]

    def __getattr__(self, name: str) -> Tensor:
        if name in self.__dict__.get("columns", ()):
            return self.packed[self.columns.index(name)]
        raise AttributeError(name)


@dataclass
class SynapseTable:
    """All synapses end to end, [S], plastic projections first; the projections' buffers are views.

    `trial` is the trial's place in the batch. `pre` and `post` count through all neurons of all trials
    (trial * N + neuron). `spans` says where those of each projection stand.
    """

    weight: Tensor
    eligibility: Tensor
    trial: Tensor
    pre: Tensor
    post: Tensor
    delay: Tensor
    plastic: int  # how many of them, from the front, are plastic
    spans: Mapping[str, slice]


@dataclass(frozen=True)
class Learning:
    """Neighbouring synapses of the table that learn by one rule from the same modulators."""

    rule: Plasticity
    listens: Mapping[str, float]
    span: slice
    projections: tuple[str, ...]


class Network(nn.Module):
    """Spiking network of a batch of independent trials, without autograd.

    Args:
        groups: in the order in which their neurons are numbered.
        projections: between those groups.
        draws: owner of the background noise; its trials are the batch.
        synaptic_gain: current per mV of weight that a spike delivers.
        modulators: what turns eligibility into weight. A plastic projection that listens to one that is not there
            does not learn.
        homeostasis: named sets of projections and their dampening.

    Rules, modulators and sets may be exchanged for others between two runs.

    Buffers besides the modules':
        time: int64 scalar, the ms that the next step computes.
        pending: [B, L, N], current on its way; slot `t % L` arrives at t (L is the longest delay).
        spike_count: int64 [B, G], spikes of each group since the start.
    """

    groups: Mapping[str, NeuronGroup]
    projections: Mapping[str, Projection]
    modulators: MutableMapping[str, Modulator]
    time: Tensor
    pending: Tensor
    spike_count: Tensor
    neurons: NeuronTable
    synapses: SynapseTable

    def __init__(
        self,
        groups: Iterable[NeuronGroup],
        projections: Iterable[Projection],
        draws: Draws,
        synaptic_gain: float,
        modulators: Iterable[Modulator] = (),
        homeostasis: Mapping[str, Homeostasis] | None = None,
    ) -> None:
        super().__init__()
        by_name = nn.ModuleDict({group.name: group for group in groups})
        self.groups = cast("Mapping[str, NeuronGroup]", by_name)
        ordered = sorted(projections, key=lambda projection: not projection.plastic)
        by_name = nn.ModuleDict({projection.name: projection for projection in ordered})
        self.projections = cast("Mapping[str, Projection]", by_name)
        by_name = nn.ModuleDict({modulator.name: modulator for modulator in modulators})
        self.modulators = cast("MutableMapping[str, Modulator]", by_name)
        self.synaptic_gain, self.draws = synaptic_gain, draws
        self.homeostasis = dict(homeostasis or {})
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
    def dopamine(self) -> Modulator | None:
        """The modulator of that name, if there is one."""
        return dict(self.modulators).get(DOPAMINE)

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
        self.neurons = NeuronTable(list(self.groups.values()))
        projections = list(self.projections.values())

        def join(parts: list[Tensor], dtype: torch.dtype) -> Tensor:
            return torch.cat([torch.empty(0, dtype=dtype, device=self.device), *parts])

        def neuron(p: Projection, end: str, index: Tensor) -> Tensor:
            return p.trial * self.size + self.groups[end].start + index

        ends = [0]
        for projection in projections:
            ends.append(ends[-1] + len(projection.weight))
        spans = {p.name: slice(low, high) for p, low, high in zip(projections, ends, ends[1:], strict=False)}
        self.synapses = SynapseTable(
            weight=join([p.weight for p in projections], self.dtype),
            eligibility=join([p.eligibility for p in projections], self.dtype),
            trial=join([p.trial for p in projections], torch.int64),
            pre=join([neuron(p, p.pre, p.pre_index) for p in projections], torch.int64),
            post=join([neuron(p, p.post, p.post_index) for p in projections], torch.int64),
            delay=join([torch.full_like(p.trial, p.delay) for p in projections], torch.int64),
            plastic=sum(len(p.weight) for p in projections if p.plastic),
            spans=spans,
        )
        for projection in projections:
            projection.weight = self.synapses.weight[spans[projection.name]]
            projection.eligibility = self.synapses.eligibility[spans[projection.name]]
        sizes = [torch.full((group.size,), k, device=self.device) for k, group in enumerate(self.groups.values())]
        self._group_of = torch.cat(sizes)

    def learning(self) -> list[Learning]:
        """Which synapses learn, and how."""
        found: list[Learning] = []
        for name, projection in self.projections.items():
            span, rule, listens = self.synapses.spans[name], projection.rule, projection.listens
            if rule is None or not listens or any(modulator not in self.modulators for modulator in listens):
                continue
            before = found[-1] if found else None
            if before and (before.rule, before.listens, before.span.stop) == (rule, listens, span.start):
                whole = slice(before.span.start, span.stop)
                found[-1] = Learning(rule, listens, whole, (*before.projections, name))
            else:
                found.append(Learning(rule, listens, span, (name,)))
        return found

    def signal(self, listens: Mapping[str, float]) -> Tensor:
        """The sum of modulators that synapses listen to (uM), [B]."""
        return reduce(torch.add, [listens[name] * m.level for name, m in self.modulators.items() if name in listens])

    def set_size(self, homeostasis: Homeostasis) -> Tensor:
        """How many pairs (or synapses) a homeostatic set's mean is over: float64 [B]."""
        size = torch.zeros(self.trials, dtype=torch.float64, device=self.device)
        for projection in (self.projections[name] for name in homeostasis.projections):
            size += projection.shape[1] * projection.shape[2] if homeostasis.count_absent else projection.count
        return size

    def background(self, times: Tensor) -> Tensor:
        """Constant and noisy background current at int64 times [T], [T, B, N]."""
        current = self.pending.new_zeros(len(times), self.trials, self.size)
        for group in self.groups.values():
            mine, name, size = current[:, :, group.span], group.name, group.size
            mine.fill_(group.current)
            if group.noise:
                draw = self.draws.uniform(stream("background", name), times, size).to(self.dtype)
                mine.copy_(uniform_noise(draw, group.current, group.noise))
            if group.gaussian:
                bits = self.draws.bits(stream("gaussian", name), times, BELL_DRAWS * size).unflatten(2, (-1, size))
                mine.copy_(gaussian_noise(mine, bell(*bits.unbind(2)).to(self.dtype), group.gaussian_scale))
            if group.kicked_below:
                bits = self.draws.bits(stream("kicks", name), times, size)
                mine.copy_(kicked(mine, bits, group.kicked_below, group.kick))
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
            sign: [B] of the network's dtype, -1 where modulators are released with a negative sign; +1 if None.
            raster: bool [T, b, N] to be filled with who fired in the first b trials.
            reward: released from outside (uM), [T, B]; none if None.

        Raises:
            ValueError: for a reward to a network without modulators.
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
        if reward is not None and not self.modulators:
            raise ValueError("reward: needs a network with a modulator")

    def step(self, background: Tensor, injected: Tensor, sign: Tensor, reward: Tensor | None = None) -> Tensor:
        """One millisecond; the one definition of the order of events inside it. Returns who fired, bool [B, N].

        1. Input: what arrives now, plus the background and the injected current.
        2. Neurons: membrane, recovery, spike and reset.
        3. Modulators: decay, the release of earlier spikes, and the reward from outside.
        4. Eligibility: decay, and the pairs that this ms's spikes complete.
        5. Weights: eligibility times modulators, within bounds.
        6. Homeostasis: sets whose mean is too high are lowered.
        7. Sending: this ms's spikes leave with the weights as they are now.
        """
        neurons, time = self.neurons, self.time
        slot = (time % self.slots).view(1)
        current = self.pending.index_select(1, slot)[:, 0] + background + injected
        self.pending.index_fill_(1, slot, 0.0)
        fired = torch.zeros_like(current, dtype=torch.bool)
        for model, span in neurons.parts:
            state, parameters = (
                [getattr(neurons, name)[:, span] for name in names] for names in (model.state, model.parameters)
            )
            *after, fires = model.step(*state, current[:, span], *parameters)
            fired[:, span] = fires
            for target, value in zip(state, after, strict=True):
                target.copy_(value)
        self.spike_count.index_add_(1, self._group_of, fired.long())
        self.learn(fired, sign, reward)
        self._send(fired)
        time += 1
        return fired

    def learn(self, fired: Tensor, sign: Tensor, reward: Tensor | None = None) -> None:
        """Steps 3 to 6 of this millisecond, for whoever fired in it, bool [B, N]; the rest as in `step`."""
        earlier = self.neurons.last_spike.clone()
        self.neurons.last_spike.copy_(torch.where(fired, self.time, self.neurons.last_spike))
        for modulator in self.modulators.values():
            counts = [fired[:, self.groups[name].span].sum(1) for name in modulator.sources.values()]
            spikes = torch.stack(counts, 1) if counts else self.spike_count.new_zeros(self.trials, 0)
            modulator.step(spikes, sign, self.time, reward)
        learning = self.learning()
        for part in learning:
            self._change_eligibility(part, fired, earlier)
            self._change_weights(part)
        if learning:
            for homeostasis in self.homeostasis.values():
                self._dampen(homeostasis)

    def _change_eligibility(self, part: Learning, fired: Tensor, earlier: Tensor) -> None:
        """Step 4; `earlier` [B, N] holds last spikes without those of this ms."""
        rule, latest = part.rule, self.neurons.last_spike
        pre, post = self.synapses.pre[part.span], self.synapses.post[part.span]
        depresses = rule.simultaneous == "depresses"
        gain = self._look_up(rule.gains, self.time - (earlier if depresses else latest))
        loss = self._look_up(rule.losses, self.time - latest)
        fired = fired.view(-1)
        rise, fall = torch.where(fired[post], gain[pre], 0.0), torch.where(fired[pre], loss[post], 0.0)
        change = rise + fall if depresses else torch.where(fired[post], rise, fall)
        self.synapses.eligibility[part.span].mul_(rule.decay).add_(change)

    def _look_up(self, window: Tensor, elapsed: Tensor) -> Tensor:
        """What a window gives after so many ms, [B * N]."""
        return window.to(self.device, self.dtype)[elapsed.clamp_max(len(window) - 1).view(-1)]

    def _change_weights(self, part: Learning) -> None:
        """Step 5."""
        weight = self.synapses.weight[part.span]
        signal = self.signal(part.listens)[self.synapses.trial[part.span]]
        change = self.synapses.eligibility[part.span] * signal
        weight.copy_(part.rule.step(weight, change))

    def _dampen(self, homeostasis: Homeostasis) -> None:
        """Step 6 of one set."""
        members = [self.projections[name] for name in homeostasis.projections]
        total = torch.zeros(self.trials, dtype=torch.float64, device=self.device)
        for projection in members:
            total.index_add_(0, projection.trial, projection.weight.double())
        over = total > homeostasis.limit * self.set_size(homeostasis)
        for projection in members:
            least = 0.0 if projection.rule is None else projection.rule.weight_min
            less = lowered(projection.weight, homeostasis.step, least)
            projection.weight.copy_(torch.where(over[projection.trial], less, projection.weight))

    def _send(self, fired: Tensor) -> None:
        """Step 7."""
        table = self.synapses
        row = table.trial * (self.slots - 1) * self.size + (self.time + table.delay) % self.slots * self.size
        sent = table.weight * self.synaptic_gain * fired.view(-1)[table.pre]
        self.pending.view(-1).index_add_(0, table.post + row, sent)
