"""Stimuli: sets of neurons that are made to fire together, and how the network answers.

Tensors over time are [T, B, ...]; `times` are the ms of a tick, int64 [T].
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from snnrl.model.draws import Draws, stream, whole_between
from snnrl.model.neurons import NEVER

NONE = -1  # in place of a stimulus's number


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
        self.register_buffer("began", members.new_full((trials,), NEVER))
        self.register_buffer("presented", members.new_zeros(trials, count))
        self.register_buffer("response", members.new_zeros(trials, count))

    def schedule(self, draws: Draws, times: Tensor) -> Tensor:
        """Which stimulus begins in each ms, int64 [T, B], NONE for none; draws as many as these ms hold."""
        trials, steps = len(self.due), len(times)
        uniform = draws.uniform(stream("stimulus"), times, 2)
        which = whole_between(uniform[..., 0], 0, self.members.shape[1] - 1)
        interval = whole_between(uniform[..., 1], self.shortest, self.longest)
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
