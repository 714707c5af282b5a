"""Dopamine: a level per trial, raised by bursts of the dopaminergic group and by rewards from outside."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from snnrl.model.elementary import exp_of


class Dopamine(nn.Module):
    """The level of dopamine of every trial (thesis 3.7).

    Args:
        source: name of the dopaminergic group; None where all dopamine comes from outside.
        trials: B.
        baseline: level without any release (uM); a negative one acts as hunger.
        tau: decay towards the baseline (ms).
        release: uM per spike.
        delay: ms from a spike to its release, at least 1.
        threshold: spikes of one ms count only if they are more than this.

    Buffers:
        level: [B], uM.
        total: float64 [B] in any precision of the network, sum of the level over all ms so far (uM ms).
        released: int64 [B, delay], a ring of spike counts; slot `t % delay` holds those of `t - delay`.
    """

    level: Tensor
    total: Tensor
    released: Tensor

    def __init__(
        self,
        source: str | None,
        trials: int,
        baseline: float,
        tau: float,
        release: float,
        delay: int,
        threshold: int,
        dtype: torch.dtype,
        device: torch.device | str,
    ) -> None:
        super().__init__()
        self.source, self.baseline, self.tau, self.release = source, baseline, tau, release
        self.delay, self.threshold = delay, threshold
        self.decay = exp_of(-1.0 / tau)
        self.register_buffer("level", torch.full((trials,), baseline, dtype=dtype, device=device))
        self.register_buffer("total", torch.zeros(trials, dtype=torch.float64, device=device))
        self.register_buffer("released", torch.zeros(trials, delay, dtype=torch.int64, device=device))

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Dopamine:
        total = self.total
        super()._apply(fn, recurse)
        self.total = total.to(self.released.device)
        return self

    def step(self, spikes: Tensor, sign: Tensor, time: Tensor, reward: Tensor | None = None) -> None:
        """Take this ms's spike counts [B] into the delay line and bring the level up to date.

        `sign` [B] is -1 where a release lowers the level (poison), else +1. `reward` [B] (uM) is dopamine
        from outside.
        """
        slot = (time % self.delay).expand(len(spikes), 1)
        arrived = self.released.gather(1, slot)[:, 0]
        self.released.scatter_(1, slot, spikes[:, None])
        counted = torch.where(arrived > self.threshold, arrived, 0).to(self.level.dtype)
        level = self.baseline + (self.level - self.baseline) * self.decay
        level = level + sign * (self.release * counted)
        self.level.copy_(level if reward is None else level + reward)
        self.total += self.level
