"""Dopamine from outside, some time after it was earned.

Tensors over time are [T, B, ...]; `times` are the ms of a tick, int64 [T].
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from snnrl.model.draws import Draws, stream, whole_between


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
        delay = whole_between(uniform, self.shortest, self.longest)
        slot = (times[:, None] + delay) % self.due.shape[1]
        self.due.scatter_add_(1, slot.T, earned.long().T)

    def take(self, times: Tensor) -> Tensor:
        """The rewards of these ms, uM [T, B] float64."""
        slot = (times % self.due.shape[1]).expand(len(self.due), -1)
        arrived = self.due.gather(1, slot)
        self.due.scatter_(1, slot, 0)
        self.given += arrived.sum(1)
        return self.amount * arrived.T.double()
