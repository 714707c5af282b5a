"""Where all changes of the weights of a run come from: dopamine by what released it, its baseline, and the bounds.

Dopamine decays linearly, so its level is, exactly, the baseline and one transient for each source of releases. What
eligibility times dopamine drives divides in the same way. `snnrl.replay.credit` does it synapse by synapse for a
stretch of one trial; here are whole runs of all trials, and sums over the synapses of a projection.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch

from snnrl.body.world.kinds import ENTERED
from snnrl.engines.fused.compiler import Program
from snnrl.engines.fused.vectors import LANES, across, load, store
from snnrl.errors import ConfigError
from snnrl.model.homeostasis import lowered
from snnrl.model.modulators import Modulator, burst, relax
from snnrl.model.network import Network
from snnrl.model.plasticity import Plasticity, hard_bounds
from snnrl.model.synapses import DOPAMINE
from snnrl.schema import FOOD
from snnrl.simulation import Simulation

SOURCES = ("food", "container", "no touch")  # of releases
FROM_FOOD, FROM_CONTAINER, FROM_NOTHING = range(3)
PARTS = (*SOURCES, "hunger", "clipped", "dampened", "rounding")
HUNGER, CLIPPED, DAMPENED, ROUNDING = range(3, 7)


class Books(NamedTuple):
    """The learning of B trials in float64: S plastic synapses of P projections, in the order of the network's table.

    `parts`, [B, P, 7], is the sum over synapses of each of PARTS, mV. `level`, [B, 3], is what is left of each source's
    releases, uM; `counts` and `causes`, [B, delay], are rings of the spikes on the way and of their sources.
    """

    parts: Any
    weight: Any
    eligibility: Any
    pre: Any  # int64 [S], neurons, counted within the trial
    post: Any
    first: Any  # int64 [P, B + 1], where the synapses of each trial begin
    from_pre: Any  # int64 [S], synapses in the order of their presynaptic neurons
    from_post: Any
    pre_first: Any  # int64 [B, N + 1], where those of each neuron begin
    post_first: Any
    last: Any  # int64 [B, N], ms of the last spike
    total: Any  # float64 [P], sum of a trial's weights
    level: Any
    counts: Any
    causes: Any
    released_by: Any  # int64 [2], the first dopaminergic neuron, and the one after the last
    baseline: Any
    fading: Any  # of the level in a ms
    release: Any
    threshold: Any
    gains: Any
    losses: Any
    decay: Any
    least: Any
    most: Any
    sets: Any  # bool [K, P], the projections of each homeostatic set
    limit: Any  # float64 [K, B], of the sum of its weights
    step: Any  # float64 [K]


class Account:
    """Books on the learning of a robot, from its start.

    Args:
        simulation: before its first tick; its network learns by one rule with hard bounds, from dopamine by bursts.

    Raises:
        ConfigError: it learns in another way, or not at all.
    """

    def __init__(self, simulation: Simulation) -> None:
        network, world = simulation.network, simulation.situation.world
        dopamine, rule = _learns_by(network)
        self.network, self.world = network, world
        self.projections = [p for p in network.projections.values() if p.plastic]
        self.books = _books(network, dopamine, rule)
        self._signed = dopamine.signed
        self._fired = torch.zeros(simulation.tick, network.trials, network.size, dtype=torch.bool)
        self._touches = world.touches.clone()
        self._lately = np.full(network.trials, FROM_NOTHING)
        self._food = torch.tensor([name == FOOD for name in world.kinds.names])
        self._containers = world.kinds.effect == ENTERED

    def run(self, simulation: Simulation, engine: Any, ticks: int) -> None:
        """Run so many ticks and book what they change."""
        for _ in range(ticks):
            start = int(self.network.time)
            simulation.run(engine, 1, self._fired)
            sign = self.world.sign.numpy() if self._signed else np.ones(self.network.trials)
            exact = self.network.synapses.weight[: self.network.synapses.plastic].double().numpy()
            _kernel()(self.books, start, self._fired.numpy(), self._causes(), sign, exact)

    def _causes(self) -> np.ndarray:
        """What bursts of the tick that has ended are put down to, int64 [B]: the latest touch in it or the one before.

        Where food and a container are touched in the same tick it is food.
        """
        touched = self.world.touches > self._touches
        self._touches.copy_(self.world.touches)
        food, container = ((touched & kinds).any(1).numpy() for kinds in (self._food, self._containers))
        now = np.where(food, FROM_FOOD, np.where(container, FROM_CONTAINER, FROM_NOTHING))
        before, self._lately = self._lately, now
        return np.where(now == FROM_NOTHING, before, now)

    def by_role(self) -> dict[str, np.ndarray]:
        """PARTS of the change of the mean weight over the synapses with a role, [B, 7], mV, by role."""
        found = {}
        for role in dict.fromkeys(p.role for p in self.projections):
            mine = [k for k, p in enumerate(self.projections) if p.role == role]
            count = sum(self.projections[k].count for k in mine)
            found[role] = self.books.parts[:, mine].sum(1) / np.asarray(count)[:, None]
        return found


def _learns_by(network: Network) -> tuple[Modulator, Plasticity]:
    """Dopamine, and the rule of all that learns; raises ConfigError."""
    dopamine, learning = network.dopamine, network.learning()
    if dopamine is None or not learning:
        raise ConfigError("robot", "...", "must learn from dopamine, if its credit is to be counted")
    rule = learning[0].rule
    if any(part.rule != rule or part.listens != {DOPAMINE: 1.0} for part in learning):
        raise ConfigError("network.rules", "...", "credit is counted of one rule that listens to dopamine alone")
    if rule.weight_rule is not hard_bounds or rule.simultaneous != "depresses":
        raise ConfigError("network.plasticity", "...", "must have hard_bounds and simultaneous=depresses for credit")
    if dopamine.released is not burst or dopamine.smoothing or list(dopamine.sources) != ["count"]:
        raise ConfigError("network.dopamine", "...", "must be released by bursts for credit")
    return dopamine, rule


def _books(network: Network, dopamine: Modulator, rule: Plasticity) -> Books:
    table, trials = network.synapses, network.trials
    plastic = [p for p in network.projections.values() if p.plastic]
    trial, pre, post = (values[: table.plastic].numpy() for values in (table.trial, table.pre, table.post))
    sent, received = (np.searchsorted(np.sort(end), np.arange(trials * network.size + 1)) for end in (pre, post))
    edges = np.arange(trials)[:, None] * network.size + np.arange(network.size + 1)
    counts = np.array([p.count.numpy() for p in plastic])
    starts = np.array([table.spans[p.name].start for p in plastic])
    release, threshold = dopamine.further
    sets = list(network.homeostasis.values())
    group = network.groups[dopamine.sources["count"]]
    return Books(
        parts=np.zeros((trials, len(plastic), len(PARTS))),
        weight=table.weight[: table.plastic].double().numpy().copy(),
        eligibility=np.zeros(table.plastic),
        pre=pre - trial * network.size,
        post=post - trial * network.size,
        first=starts[:, None] + np.pad(counts.cumsum(1), ((0, 0), (1, 0))),
        from_pre=np.argsort(pre, kind="stable"),
        from_post=np.argsort(post, kind="stable"),
        pre_first=sent[edges],
        post_first=received[edges],
        last=network.neurons.last_spike.numpy().copy(),
        total=np.zeros(len(plastic)),
        level=np.zeros((trials, len(SOURCES))),
        counts=np.zeros((trials, dopamine.delay), np.int64),
        causes=np.zeros((trials, dopamine.delay), np.int64),
        released_by=np.array([group.span.start, group.span.stop]),
        baseline=dopamine.baseline,
        fading=dopamine.decay,
        release=release,
        threshold=threshold,
        gains=rule.gains.numpy(),
        losses=rule.losses.numpy(),
        decay=rule.decay,
        least=rule.weight_min,
        most=rule.weight_max,
        sets=np.array([[p.name in one.projections for p in plastic] for one in sets], bool).reshape(-1, len(plastic)),
        limit=np.array([(one.limit * network.set_size(one)).numpy() for one in sets]).reshape(-1, trials),
        step=np.array([one.step for one in sets], float),
    )


@cache
def _kernel() -> Any:
    return Program(np.float64, {}).kernel(book)


def book(b: Any, time: Any, fired: Any, causes: Any, signs: Any, exact: Any) -> None:
    """A tick of all trials: who fired, bool [tick, B, N], and at its end the run's own weights, float64 [S]."""
    for trial in range(b.last.shape[0]):
        for row in range(fired.shape[0]):
            now = time + row
            signal = listen(b, trial, now, fired[row, trial], causes[trial], signs[trial])
            remember(b, trial, now, fired[row, trial])
            change(b, trial, signal)
            dampen(b, trial)
        for p in range(b.first.shape[0]):
            for s in range(b.first[p, trial], b.first[p, trial + 1]):
                b.parts[trial, p, ROUNDING] += exact[s] - b.weight[s]
                b.weight[s] = exact[s]


def listen(b: Any, trial: Any, now: Any, fired: Any, cause: Any, sign: Any) -> Any:
    """Step 3 of `Network.step`, each source's part of dopamine by itself; the whole level."""
    slot, spikes = now % b.counts.shape[1], 0
    for n in range(b.released_by[0], b.released_by[1]):
        spikes += fired[n]
    released = sign * burst(b.counts[trial, slot], b.release, b.threshold)
    signal = b.baseline
    for source in range(b.level.shape[1]):
        level = relax(b.level[trial, source], 0.0, b.fading)
        if source == b.causes[trial, slot]:
            level += released
        b.level[trial, source] = level
        signal += level
    b.counts[trial, slot], b.causes[trial, slot] = spikes, cause
    return signal


def remember(b: Any, trial: Any, now: Any, fired: Any) -> None:
    """Step 4 of `Network.step`, but for the decay, which `change` does for the ms to come."""
    for n in range(fired.shape[0]):
        if fired[n]:
            for k in range(b.post_first[trial, n], b.post_first[trial, n + 1]):
                s = b.from_post[k]
                b.eligibility[s] += b.gains[min(now - b.last[trial, b.pre[s]], b.gains.shape[0] - 1)]
    for n in range(fired.shape[0]):
        if fired[n]:
            b.last[trial, n] = now
    for n in range(fired.shape[0]):
        if fired[n]:
            for k in range(b.pre_first[trial, n], b.pre_first[trial, n + 1]):
                s = b.from_pre[k]
                b.eligibility[s] += b.losses[min(now - b.last[trial, b.post[s]], b.losses.shape[0] - 1)]


def change(b: Any, trial: Any, signal: Any) -> None:
    """Step 5 of `Network.step`, and what of it is whose; LANES synapses at a time, then those that are left."""
    for p in range(b.first.shape[0]):
        s, end = b.first[p, trial], b.first[p, trial + 1]
        eligible, clipped, total = 0.0, 0.0, 0.0
        if s + LANES <= end:
            nothing = load(b.weight, s) * 0.0
            eligibles, clips, totals = nothing, nothing, nothing
            while s + LANES <= end:
                eligibility, weight = load(b.eligibility, s), load(b.weight, s)
                driven = eligibility * signal
                bounded = hard_bounds(weight, driven, b.least, b.most)
                store(b.weight, s, bounded)
                store(b.eligibility, s, eligibility * b.decay)
                eligibles, totals = eligibles + eligibility, totals + bounded
                clips = clips + (bounded - (weight + driven))
                s += LANES
            eligible, clipped, total = across(eligibles), across(clips), across(totals)
        while s < end:
            driven = b.eligibility[s] * signal
            free = b.weight[s] + driven
            b.weight[s] = hard_bounds(b.weight[s], driven, b.least, b.most)
            eligible += b.eligibility[s]
            b.eligibility[s] *= b.decay
            clipped += b.weight[s] - free
            total += b.weight[s]
            s += 1
        for source in range(b.level.shape[1]):
            b.parts[trial, p, source] += b.level[trial, source] * eligible
        b.parts[trial, p, HUNGER] += b.baseline * eligible
        b.parts[trial, p, CLIPPED] += clipped
        b.total[p] = total


def dampen(b: Any, trial: Any) -> None:
    """Step 6 of `Network.step`."""
    for k in range(b.sets.shape[0]):
        total = 0.0
        for p in range(b.first.shape[0]):
            if b.sets[k, p]:
                total += b.total[p]
        for p in range(b.first.shape[0] if total > b.limit[k, trial] else 0):
            for s in range(b.first[p, trial], b.first[p, trial + 1] if b.sets[k, p] else b.first[p, trial]):
                less = lowered(b.weight[s], b.step[k], b.least)
                b.parts[trial, p, DAMPENED] += less - b.weight[s]
                b.weight[s] = less
