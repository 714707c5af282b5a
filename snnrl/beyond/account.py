"""Where all changes of the weights of a run come from: dopamine by what released it, its baseline, and the bounds.

Dopamine decays linearly, so its level is, exactly, the baseline and one transient for each source of releases. What
eligibility times dopamine drives divides in the same way. `snnrl.replay.credit` does it synapse by synapse for a
stretch of one trial; here are whole runs of all trials, and sums over the synapses of a projection.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import torch

from snnrl.beyond.booking import FROM_CONTAINER, FROM_FOOD, FROM_NOTHING, PARTS, SOURCES, Books, book
from snnrl.body.world.kinds import ENTERED
from snnrl.engines.fused.compiler import Program
from snnrl.errors import ConfigError
from snnrl.model.modulators import Modulator, burst
from snnrl.model.network import Network
from snnrl.model.plasticity import Plasticity, hard_bounds
from snnrl.model.synapses import DOPAMINE
from snnrl.schema import FOOD
from snnrl.simulation import Simulation


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
