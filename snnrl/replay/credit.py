"""Which synapses a reward changed, and why: eligibility, dopamine, and the pairs of spikes behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from snnrl.files import csv_of
from snnrl.model.network import Network
from snnrl.model.neurons import NEVER
from snnrl.model.plasticity import Plasticity
from snnrl.schema import FOOD

TRANSIENT = 5  # in units of tau: how long after its last release a transient of dopamine is followed
LISTED = 5  # pairs of each synapse in credit.csv
COLUMNS = (
    *("reward", "cause", "start_ms", "end_ms", "dopamine_integral", "projection", "pre", "post", "weight_before"),
    *("weight_after", "eligibility", "driven", "clipped", "dampened", "rounding", "pairs", "older"),
)


@dataclass
class Reward:
    """One transient of dopamine and what it did to the plastic synapses of one trial.

    For each synapse, float64 [S], `after - before` is `driven + clipped + dampened + rounding`, all in mV.

    Attributes:
        start: ms of the first release. end: the first ms that is no longer followed.
        cause: what was touched in this tick or the one before, joined by "+"; "none" for a burst without a touch.
        before, after: weight at the beginning of `start` and at the end.
        eligibility: in the ms `start`, as it meets the dopamine.
        driven: sum over ms of eligibility times dopamine. clipped: what the bounds of the weight took or gave.
        dampened: by homeostasis. rounding: of the run's own precision, beside this one in float64.
        dopamine: sum of the level over ms (uM ms).
    """

    start: int
    end: int
    cause: str
    before: np.ndarray
    eligibility: np.ndarray
    dopamine: float = 0.0

    def __post_init__(self) -> None:
        self.driven, self.clipped, self.dampened, self.rounding = (np.zeros(len(self.before)) for _ in range(4))
        self.after = self.before

    @property
    def change(self) -> np.ndarray:
        return self.after - self.before


class Ledger:
    """Follows the learning of a network of one trial, ms by ms in float64, and books every change of a weight.

    Args:
        network: of one trial, in float64 on the CPU, in the state from which to follow; it is stepped by
            `Network.learn` alone, with the spikes of the run.

    Attributes:
        rewards: transients of dopamine so far, in order.
        levels: dopamine after each ms (uM).
        last_spike: of each neuron before the first ms, int64 [N]. carried: eligibility before it, float64 [S].
    """

    def __init__(self, network: Network) -> None:
        self.network, self.start = network, int(network.time)
        plastic = max((part.span.stop for part in network.learning()), default=0)
        self.weight, self.eligibility = network.synapses.weight[:plastic], network.synapses.eligibility[:plastic]
        self.last_spike = network.neurons.last_spike[0].numpy().copy()
        self.carried = self.eligibility.numpy().copy()
        self.rewards: list[Reward] = []
        self.levels: list[float] = []

    def follow(self, raster: Tensor, sign: float, cause: str, weight: Tensor) -> None:
        """Follow one control tick of the run.

        Args:
            raster: who fired, bool [tick, 1, N].
            sign: of dopamine.
            cause: what a reward in this tick is put down to.
            weight: the run's own plastic weights at the end of the tick, [S].
        """
        for fired in raster:
            self._learn(fired, torch.full((1,), sign, dtype=torch.float64), cause)
        exact = weight.double().cpu()
        if self._following():
            self.rewards[-1].rounding += (exact - self.weight).numpy()
            self.rewards[-1].after = exact.numpy().copy()
        self.weight.copy_(exact)

    def _following(self) -> bool:
        return bool(self.rewards) and self.rewards[-1].end >= int(self.network.time)

    def _learn(self, fired: Tensor, sign: Tensor, cause: str) -> None:
        network, now, dopamine = self.network, int(self.network.time), self.network.dopamine
        before = self.weight.clone()
        if dopamine is None:
            network.learn(fired, sign)
            network.time += 1
            return
        network.learn(fired, sign)
        self.levels.append(float(dopamine.level[0]))
        if float(dopamine.release()):
            end = now + 1 + round(TRANSIENT * dopamine.tau)
            if self.rewards and now < self.rewards[-1].end:
                self.rewards[-1].end = end
            else:
                eligibility = self.eligibility.numpy().copy()
                self.rewards.append(Reward(now, end, cause, before.numpy(), eligibility))
        network.time += 1
        if self.rewards and now < self.rewards[-1].end:
            self._book(self.rewards[-1], before)

    def _book(self, reward: Reward, before: Tensor) -> None:
        for part in self.network.learning():
            driven = self.eligibility[part.span] * float(self.network.signal(part.listens))
            free, bounded = before[part.span] + driven, part.rule.step(before[part.span], driven)
            reward.driven[part.span] += driven.numpy()
            reward.clipped[part.span] += (bounded - free).numpy()
            reward.dampened[part.span] += (self.weight[part.span] - bounded).numpy()
        reward.after = self.weight.numpy().copy()
        reward.dopamine += self.levels[-1]

    def close(self) -> None:
        """End the last transient where the recording ends."""
        if self.rewards:
            self.rewards[-1].end = min(self.rewards[-1].end, int(self.network.time))


@dataclass(frozen=True)
class Pairs:
    """The nearest-neighbour pairs of spikes of one synapse, in the order in which they were completed, [P] each.

    Attributes:
        pre, post: times of the two spikes (ms). value: what the pair added to the eligibility when complete.
    """

    pre: np.ndarray
    post: np.ndarray
    value: np.ndarray

    def decayed(self, rule: Plasticity, time: int) -> np.ndarray:
        """What is left of the pairs complete by `time` (ms), the same order."""
        at = np.maximum(self.pre, self.post)
        at = at[: np.searchsorted(at, time, "right")]
        return np.asarray(self.value[: len(at)] * np.exp(-(time - at) / rule.tau_eligibility))


def pairs_of(pre: np.ndarray, post: np.ndarray, rule: Plasticity, start: int = 0) -> Pairs:
    """All pairs that step 4 of `Network.step` makes, complete at `start` (ms) or later, of two trains of spikes.

    Args:
        pre, post: ms, ascending; what is before `start` can only be the earlier spike of a pair.
        rule: says what two spikes of one ms make, see `Plasticity`.
    """
    depresses = rule.simultaneous == "depresses"
    pre_before, post_before = np.append(NEVER, pre), np.append(NEVER, post)
    late = pre if depresses else np.setdiff1d(pre, post)
    partner = pre_before[np.searchsorted(pre, post, "left" if depresses else "right")]
    missed = post_before[np.searchsorted(post, late, "right")]
    gain, loss = (
        window.numpy()[np.minimum(elapsed, len(window) - 1)]
        for window, elapsed in ((rule.gains, post - partner), (rule.losses, late - missed))
    )
    at = np.concatenate([post, late])
    pairs = np.concatenate([partner, late]), np.concatenate([post, missed]), np.concatenate([gain, loss])
    real = (np.minimum(pairs[0], pairs[1]) > NEVER) & (at >= start)
    order = np.argsort(at[real], kind="stable")
    return Pairs(*(values[real][order] for values in pairs))


@dataclass(frozen=True)
class Synapse:
    """A plastic synapse: its projection, its ends within their groups, and within the network, and its rule."""

    projection: str
    pre: int
    post: int
    ends: tuple[int, int]
    rule: Plasticity


class Credit:
    """The rewards of a ledger with the pairs of spikes that explain them.

    Args:
        ledger: after the last tick.
        time, neuron: all spikes since the ledger's first ms, int64 [n]; `time` in ms, ascending.

    Attributes:
        rewards: see `Reward`. synapses: the plastic ones, in the order of a reward's arrays.
        pairs: of each synapse, all since the ledger's first ms.
    """

    def __init__(self, ledger: Ledger, time: np.ndarray, neuron: np.ndarray) -> None:
        network = ledger.network
        self.rewards = ledger.rewards
        self.start, self.carried = ledger.start, ledger.carried
        self.synapses = _synapses(network)[: len(self.carried)]
        by_neuron = np.argsort(neuron, kind="stable")
        edges = np.searchsorted(neuron[by_neuron], np.arange(network.size + 1))
        earlier = [last[last > NEVER] for last in ledger.last_spike[:, None]]
        self.trains = [
            np.append(earlier[n], time[by_neuron[edges[n] : edges[n + 1]]]).astype(np.int64)
            for n in range(network.size)
        ]
        self.pairs = [
            pairs_of(self.trains[s.ends[0]], self.trains[s.ends[1]], s.rule, self.start) for s in self.synapses
        ]

    def eligibility(self, synapse: int, time: int) -> tuple[np.ndarray, float]:
        """What makes up a synapse's eligibility in a ms: each pair, decayed, and what is left from before the start."""
        rule = self.synapses[synapse].rule
        rest = self.carried[synapse] * np.exp((self.start - 1 - time) / rule.tau_eligibility)
        return self.pairs[synapse].decayed(rule, time), float(rest)

    def table(self) -> str:
        """credit.csv: a row for each reward and synapse, those that it changed most first."""
        ordered = [np.argsort(-np.abs(reward.change), kind="stable").tolist() for reward in self.rewards]
        parts = zip(self.rewards, ordered, strict=True)
        return csv_of(COLUMNS, (self._row(n, reward, k) for n, (reward, order) in enumerate(parts) for k in order))

    def _row(self, number: int, reward: Reward, k: int) -> list[object]:
        synapse, pairs = self.synapses[k], self.pairs[k]
        decayed, rest = self.eligibility(k, reward.start)
        first = max(0, len(decayed) - LISTED)
        listed = (f"{pairs.pre[n]}>{pairs.post[n]}:{decayed[n]:+.3e}" for n in range(first, len(decayed)))
        booked = (
            *(reward.before[k], reward.after[k], reward.eligibility[k]),
            *(reward.driven[k], reward.clipped[k], reward.dampened[k], reward.rounding[k]),
        )
        return [
            *(number, reward.cause, reward.start, reward.end, f"{reward.dopamine:.6g}"),
            *(synapse.projection, synapse.pre, synapse.post),
            *(f"{value:.9g}" for value in booked),
            " ".join(listed),
            f"{decayed[:first].sum() + rest:.3e}",
        ]


def _synapses(network: Network) -> list[Synapse]:
    found = []
    for projection in network.projections.values():
        if projection.rule is not None:
            first, second = network.groups[projection.pre].start, network.groups[projection.post].start
            for pre, post in zip(projection.pre_index.tolist(), projection.post_index.tolist(), strict=True):
                found.append(Synapse(projection.name, pre, post, (first + pre, second + post), projection.rule))
    return found


def cause_of(touches: dict[str, int], poison: bool) -> str:
    """What a reward is put down to, from how often each kind of object was touched shortly before.

    `poison` is whether food is poison.
    """
    touched = [name for name, count in touches.items() if count]
    return "+".join("poison" if poison and name == FOOD else name for name in touched) or "none"
