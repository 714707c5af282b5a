"""Neuromodulators: levels that spikes of some groups, or rewards from outside, raise and lower."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from snnrl.model.elementary import exp_of
from snnrl.model.plasticity import arguments


def burst(count: Tensor, release: float, threshold: float) -> Tensor:
    """What `count` spikes of one ms release (uM), if they are more than `threshold` (thesis 3.7)."""
    return torch.where(count > threshold, release * count, 0.0)


def deviation(count: Tensor, release: float, tonic: float) -> Tensor:
    """What `count` spikes of one ms release (uM) beyond `tonic` ones; less than nothing if they are fewer."""
    return release * (count - tonic)


def relax(level: Tensor, baseline: float, decay: float) -> Tensor:
    """The level (uM) one ms later, without any release."""
    return baseline + (level - baseline) * decay


def mean_rate(rate: Tensor, count: Tensor, fading: float) -> Tensor:
    """A running mean of spikes per ms, one ms later."""
    return fading * rate + (1.0 - fading) * count


class Modulator(nn.Module):
    """One modulator's level in every trial; dopamine is one (thesis 3.7).

    Args:
        name: the modulator's name in its network.
        sources: the groups whose spikes release it, by the names of the first arguments of `released`; none where
            all of it comes from outside.
        trials: B.
        baseline: level without any release (uM); a negative one of dopamine acts as hunger.
        tau: decay towards the baseline (ms).
        delay: ms from a spike to its release, at least 1.
        released: an elementwise function of the spikes of each source, to what they release in a ms (uM). Its further
            arguments are among `values`.
        values: numbers by name.
        smoothing: time constant (ms) of a running mean rate (spikes per ms) that `released` gets in place of
            the spikes of one ms; 0 for those.
        signed: whether a negative sign of the situation (poison) turns a release into its opposite.
        reward: uM that one uM of reward from outside is to it.

    Buffers:
        level: [B], uM.
        total: float64 [B] in any precision of the network, sum of the level over all ms so far (uM ms).
        pending: int64 [B, K, delay], a ring of the K sources' spikes; slot `t % delay` holds those of `t - delay`.
        rate: [B, K], what `released` was last given: the counts, or their running mean.

    Raises:
        ValueError: the function has an argument that nothing is called like.
    """

    level: Tensor
    total: Tensor
    pending: Tensor
    rate: Tensor

    def __init__(
        self,
        name: str,
        sources: Mapping[str, str],
        trials: int,
        baseline: float,
        tau: float,
        delay: int,
        values: Mapping[str, float],
        dtype: torch.dtype,
        device: torch.device | str,
        released: Callable[..., Tensor] = burst,
        smoothing: float = 0.0,
        signed: bool = True,
        reward: float = 1.0,
    ) -> None:
        super().__init__()
        self.name, self.sources, self.baseline, self.tau, self.delay = name, dict(sources), baseline, tau, delay
        self.released, self.values, self.signed, self.reward = released, dict(values), signed, reward
        self.smoothing = smoothing
        self.further  # noqa: B018  # so that a name that is missing is noticed here
        self.register_buffer("level", torch.full((trials,), baseline, dtype=dtype, device=device))
        self.register_buffer("total", torch.zeros(trials, dtype=torch.float64, device=device))
        ring = torch.zeros(trials, len(self.sources), delay, dtype=torch.int64, device=device)
        self.register_buffer("pending", ring)
        self.register_buffer("rate", torch.zeros(trials, len(self.sources), dtype=dtype, device=device))

    @property
    def tau(self) -> float:
        return self._tau

    @tau.setter
    def tau(self, tau: float) -> None:
        self._tau, self.decay = tau, exp_of(-1.0 / tau)

    @property
    def smoothing(self) -> float:
        return self._smoothing

    @smoothing.setter
    def smoothing(self, smoothing: float) -> None:
        self._smoothing, self.fading = smoothing, exp_of(-1.0 / smoothing) if smoothing else 0.0

    @property
    def further(self) -> tuple[float, ...]:
        """The values of the further arguments of `released`."""
        if not self.sources:
            return ()
        return arguments(self.released, len(self.sources), self.values)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Modulator:
        total = self.total
        super()._apply(fn, recurse)
        self.total = total.to(self.pending.device)
        return self

    def release(self) -> Tensor:
        """What the sources have released in the last ms (uM), [B]."""
        return self.released(*self.rate.unbind(1), *self.further) if self.sources else torch.zeros_like(self.level)

    def step(self, spikes: Tensor, sign: Tensor, time: Tensor, reward: Tensor | None = None) -> None:
        """Take this ms's spike counts, int64 [B, K], into the delay line and bring the level up to date.

        `sign` [B] is -1 where a release lowers the level (poison), else +1. `reward` [B] (uM) is what comes from
        outside.
        """
        level = relax(self.level, self.baseline, self.decay)
        if self.sources:
            slot = (time % self.delay).expand(*spikes.shape, 1)
            counts = self.pending.gather(2, slot)[..., 0].to(level.dtype)
            self.pending.scatter_(2, slot, spikes[..., None])
            if self.smoothing:
                counts = mean_rate(self.rate, counts, self.fading)
            self.rate.copy_(counts)
            level = level + (sign * self.release() if self.signed else self.release())
        self.level.copy_(level if reward is None else level + self.reward * reward)
        self.total += self.level
