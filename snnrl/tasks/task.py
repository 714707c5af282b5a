"""What a network without a body is asked to do: stimuli, and dopamine that rewards stimuli or spikes.

Tensors over time are [T, B, ...]; `times` are the ms of a tick, int64 [T].
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from snnrl.model.draws import Draws, stream
from snnrl.model.network import Network

NONE = -1  # in place of a stimulus's number
LONG_AGO = -(1 << 40)  # ms


class Reward(nn.Module):
    """Dopamine from outside, given a random whole number of ms after the event that earns it.

    Args:
        amount: uM.
        shortest, longest: bounds of the delay (ms), both included.
        tick: ms for which rewards are handed out at a time.
        trials: their numbers, int64 [B].

    Buffers:
        due: int64 [B, L], a ring of rewards to be given; slot `t % L` is that of ms t.
        given: int64 [B], rewards since the start.
    """

    due: Tensor
    given: Tensor

    def __init__(self, amount: float, shortest: int, longest: int, tick: int, trials: Tensor) -> None:
        super().__init__()
        self.amount, self.shortest, self.longest = amount, shortest, longest
        self.register_buffer("due", trials.new_zeros(len(trials), longest + tick))
        self.register_buffer("given", torch.zeros_like(trials))

    def promise(self, earned: Tensor, draws: Draws, times: Tensor) -> None:
        """Put a reward on its way for every event, bool [T, B]."""
        if not earned.any():
            return
        uniform = draws.uniform(stream("reward delay"), times, 1)[..., 0]
        delay = _between(uniform, self.shortest, self.longest)
        slot = (times[:, None] + delay) % self.due.shape[1]
        self.due.scatter_add_(1, slot.T, earned.long().T)

    def take(self, times: Tensor) -> Tensor:
        """The rewards of these ms, uM [T, B] float64."""
        slot = (times % self.due.shape[1]).expand(len(self.due), -1)
        arrived = self.due.gather(1, slot)
        self.due.scatter_(1, slot, 0)
        self.given += arrived.sum(1)
        return self.amount * arrived.T.double()


class Stimuli(nn.Module):
    """Sets of neurons; at random intervals, all neurons of one random set get a pulse of 1 ms.

    Args:
        members: the neurons of each stimulus in each trial, int64 [B, K, n].
        current: of the pulse.
        shortest, longest: bounds of the interval between two stimuli (ms), both included.
        window: spikes of all neurons 1 to `window` ms after a stimulus are its response.
        rewarded: number of the stimulus that earns rewards.

    Buffers:
        due: int64 [B], when the next stimulus comes (ms).
        latest, began: int64 [B], the last stimulus and its time.
        presented, response: int64 [B, K], presentations and spikes of response since the start.
    """

    members: Tensor
    due: Tensor
    latest: Tensor
    began: Tensor
    presented: Tensor
    response: Tensor

    def __init__(
        self, members: Tensor, current: float, shortest: int, longest: int, window: int, rewarded: int
    ) -> None:
        super().__init__()
        self.current, self.shortest, self.longest = current, shortest, longest
        self.window, self.rewarded = window, rewarded
        trials, count, _ = members.shape
        self.register_buffer("members", members)
        self.register_buffer("due", members.new_full((trials,), shortest))
        self.register_buffer("latest", members.new_zeros(trials))
        self.register_buffer("began", members.new_full((trials,), LONG_AGO))
        self.register_buffer("presented", members.new_zeros(trials, count))
        self.register_buffer("response", members.new_zeros(trials, count))

    def schedule(self, draws: Draws, times: Tensor) -> Tensor:
        """Which stimulus begins in each ms, int64 [T, B], NONE for none; draws as many as these ms hold."""
        trials, steps = len(self.due), len(times)
        uniform = draws.uniform(stream("stimulus"), times, 2)
        which = _between(uniform[..., 0], 0, self.members.shape[1] - 1)
        interval = _between(uniform[..., 1], self.shortest, self.longest)
        begins = self.due.new_full((steps, trials), NONE)
        for _ in range(math.ceil(steps / self.shortest)):
            row = self.due - times[0]
            inside = row < steps
            row = row.clamp_max(steps - 1)[None]
            begins.scatter_(0, row, torch.where(inside, which.gather(0, row)[0], begins.gather(0, row)[0])[None])
            self.due += inside * interval.gather(0, row)[0]
        return begins

    def add_pulses(self, begins: Tensor, current: Tensor) -> None:
        """Add the pulses of these stimuli to a current [T, B, N]."""
        row, trial = (begins != NONE).nonzero(as_tuple=True)
        current[row[:, None], trial[:, None], self.members[trial, begins[row, trial]]] += self.current

    def respond(self, begins: Tensor, fired: Tensor, times: Tensor) -> None:
        """Count presentations, and the spikes bool [T, B, N] that answer them."""
        trials = torch.arange(len(self.due), device=times.device)
        started = torch.where(begins != NONE, times[:, None], self.began).cummax(0).values
        row = started - times[0]
        shown = torch.where(row < 0, self.latest, begins.gather(0, row.clamp_min(0)))
        elapsed = times[:, None] - started
        answers = fired.sum(2) * ((elapsed > 0) & (elapsed <= self.window))
        self.response.scatter_add_(1, shown.T, answers.T)
        self.presented.scatter_add_(1, begins.clamp_min(0).T, (begins != NONE).long().T)
        self.latest.copy_(shown[-1, trials])
        self.began.copy_(started[-1])


class Coincidence(nn.Module):
    """Watches one plastic synapse of every trial for a postsynaptic spike soon after a presynaptic one.

    Args:
        network: holds the synapse.
        projection: the synapse is drawn from those of this projection that join two different neurons.
        window: it is a coincidence if the last presynaptic spike is 1 to `window - 1` ms old.
        weight: what the synapse starts with (mV).

    Buffers:
        synapse: int64 [B], its place among the network's synapses.
        last_pre: int64 [B], time of the last presynaptic spike (ms).
        count: int64 [B], coincidences since the start.
    """

    synapse: Tensor
    last_pre: Tensor
    count: Tensor

    def __init__(self, network: Network, projection: str, window: int, weight: float) -> None:
        super().__init__()
        self.window = window
        chosen = network.projections[projection]
        names = list(network.projections)
        first = sum(len(network.projections[name].weight) for name in names[: names.index(projection)])
        drawn = network.draws.at_start(stream("chosen synapse"), 1)[:, 0]
        usable = chosen.pre_index != chosen.post_index if chosen.pre == chosen.post else chosen.trial >= 0
        places = []
        for trial in range(network.trials):
            mine = ((chosen.trial == trial) & usable).nonzero()[:, 0]
            assert len(mine), "a projection without synapses"
            places.append(first + mine[int(drawn[trial] * len(mine))])
        self.register_buffer("synapse", torch.stack(places))
        self.register_buffer("last_pre", torch.full_like(self.synapse, LONG_AGO))
        self.register_buffer("count", torch.zeros_like(self.synapse))
        network.synapses.weight[self.synapse] = weight

    def observe(self, network: Network, fired: Tensor, times: Tensor) -> Tensor:
        """Coincidences in spikes bool [T, B, N]: bool [T, B]."""
        trials = torch.arange(network.trials, device=fired.device)
        ends = (network.synapses.pre[self.synapse], network.synapses.post[self.synapse])
        pre, post = (fired[:, trials, end % network.size] for end in ends)
        last = torch.where(pre, times[:, None], self.last_pre).cummax(0).values
        elapsed = times[:, None] - last
        found = post & (elapsed > 0) & (elapsed < self.window)
        self.last_pre.copy_(last[-1])
        self.count += found.sum(0)
        return found


class Task(nn.Module):
    """Stimuli, a watched synapse, or both; what earns a reward is the rewarded stimulus and the coincidence.

    Args:
        tick: how long the network runs between `begin` and `finish` (ms).
        reward: what is given.
        stimuli, coincidence: either may be None.
    """

    def __init__(self, tick: int, reward: Reward, stimuli: Stimuli | None, coincidence: Coincidence | None) -> None:
        super().__init__()
        self.tick, self.reward = tick, reward
        self.stimuli, self.coincidence = stimuli, coincidence
        self._begins = torch.empty(0)

    watches = True

    def begin(self, network: Network) -> tuple[Tensor, None, Tensor]:
        """Current [tick, B, N], no sign, and dopamine (uM) [tick, B] of the coming tick, of the network's dtype."""
        times = network.time + torch.arange(self.tick, device=network.device)
        current = network.pending.new_zeros(self.tick, network.trials, network.size)
        if self.stimuli is not None:
            self._begins = self.stimuli.schedule(network.draws, times)
            self.stimuli.add_pulses(self._begins, current)
            self.reward.promise(self._begins == self.stimuli.rewarded, network.draws, times)
        return current, None, self.reward.take(times).to(network.dtype)

    def finish(self, network: Network, fired: Tensor) -> None:
        """Look at who fired in the tick that has just been run, bool [tick, B, N]."""
        times = network.time - self.tick + torch.arange(self.tick, device=network.device)
        if self.stimuli is not None:
            self.stimuli.respond(self._begins, fired, times)
        if self.coincidence is not None:
            self.reward.promise(self.coincidence.observe(network, fired, times), network.draws, times)


def _between(uniform: Tensor, least: int, most: int) -> Tensor:
    """Whole numbers in [least, most] from numbers uniform in [0, 1), int64."""
    return least + (uniform * (most - least + 1)).long()
