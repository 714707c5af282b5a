"""A task: the situation of a network without a body; stimuli, and dopamine that rewards stimuli or spikes."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from snnrl.model.network import Network
from snnrl.tasks.coincidences import Coincidence
from snnrl.tasks.rewards import Reward
from snnrl.tasks.stimuli import Stimuli


class Task(nn.Module):
    """Stimuli, a watched synapse, or both; what earns a reward is the rewarded stimulus and the coincidence.

    Args:
        tick: how long the network runs between `begin` and `finish` (ms).
        reward: what is given.
        stimuli, coincidence: either may be None.
    """

    watches = True  # spikes may be answers, and may earn rewards

    def __init__(self, tick: int, reward: Reward, stimuli: Stimuli | None, coincidence: Coincidence | None) -> None:
        super().__init__()
        self.tick, self.reward = tick, reward
        self.stimuli, self.coincidence = stimuli, coincidence
        self._begins = torch.empty(0)

    def begin(self, network: Network) -> tuple[Tensor, None, Tensor]:
        """The part of a tick that takes no time; the one definition of its order.

        1. Stimuli are drawn for the coming tick, and their pulses; the rewarded one earns its reward.
        2. The rewards of the coming tick are handed out.

        Returns the currents of the coming tick, [tick, B, N], no sign, and its rewards (uM), [tick, B], of the
        network's dtype.
        """
        times = network.time + torch.arange(self.tick, device=network.device)
        current = network.pending.new_zeros(self.tick, network.trials, network.size)
        if self.stimuli is not None:
            self._begins = self.stimuli.schedule(network.draws, times)
            self.stimuli.add_pulses(self._begins, current)
            self.reward.promise(self._begins == self.stimuli.rewarded, network.draws, times)
        return current, None, self.reward.take(times).to(network.dtype)

    def finish(self, network: Network, fired: Tensor) -> None:
        """Look at who fired in the tick that has just been run, bool [tick, B, N]: answers, and what earns rewards."""
        times = network.time - self.tick + torch.arange(self.tick, device=network.device)
        if self.stimuli is not None:
            self.stimuli.respond(self._begins, fired, times)
        if self.coincidence is not None:
            self.reward.promise(self.coincidence.observe(network, fired, times), network.draws, times)
