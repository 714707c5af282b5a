"""Counter-based random numbers: every value is a pure function of its owner.

A value is named by (seed, trial, stream, time, index) and computed by Philox4x32-10 (Salmon et al.,
"Parallel random numbers: as easy as 1, 2, 3", SC 2011). No generator state exists, so a trial is the
same alone, in a batch and in any part of a run, and every engine draws the same numbers.

Layout of the counter: word 0 is the index, word 1 the time divided by four, word 2 the stream, word 3
the trial; the key is the seed. The four output words are the values of four consecutive times.
"""

from __future__ import annotations

import math
import zlib

import torch
from torch import Tensor

from snnrl.model.elementary import exp, exp_of

MULTIPLIER_0 = 0xD2511F53
MULTIPLIER_1 = 0xCD9E8D57
WEYL_0 = 0x9E3779B9
WEYL_1 = 0xBB67AE85
ROUNDS = 10
MASK = 0xFFFFFFFF
BELL_DRAWS = 4
BELL_MIDDLE = 1530  # the mean of twelve bytes' sum
BELL_SPREAD = math.sqrt(65535.0)  # twelve times the variance of a byte, (256^2 - 1) / 12
BITS = 24  # of a word that are used: exact in float32, so that every precision sees the same number


def stream(*names: str) -> int:
    """A stream's number, from what it is for and whom it serves (CRC-32 of the joined names)."""
    return zlib.crc32("/".join(names).encode())


def philox(counter: tuple[Tensor, Tensor, Tensor, Tensor], seed: int) -> tuple[Tensor, ...]:
    """Philox4x32-10 of four broadcastable int64 tensors that hold 32-bit words; four words back."""
    c0, c1, c2, c3 = counter
    k0, k1 = seed & MASK, (seed >> 32) & MASK
    for _ in range(ROUNDS):
        p0, p1 = c0 * MULTIPLIER_0, c2 * MULTIPLIER_1
        c0, c1 = ((p1 >> 32) & MASK) ^ c1 ^ k0, p1 & MASK
        c2, c3 = ((p0 >> 32) & MASK) ^ c3 ^ k1, p0 & MASK
        k0, k1 = (k0 + WEYL_0) & MASK, (k1 + WEYL_1) & MASK
    return c0, c1, c2, c3


class Draws:
    """The random numbers of a batch of trials.

    Args:
        seed: 64-bit seed of the whole run.
        trials: the trials' numbers, int64 [B]; they need not start at 0 nor be consecutive.
    """

    def __init__(self, seed: int, trials: Tensor) -> None:
        self.seed = seed
        self.trials = trials

    def to(self, device: torch.device | str) -> Draws:
        return Draws(self.seed, self.trials.to(device))

    def bits(self, stream: int, times: Tensor, count: int) -> Tensor:
        """Whole numbers uniform in [0, 2**24): int64 [T, B, count] for int64 times [T] (ms)."""
        times = times.view(-1, 1, 1)
        index = torch.arange(count, device=times.device)
        zero = torch.zeros_like(self.trials)
        words = philox((index, times >> 2, zero[:, None] + stream, self.trials[:, None]), self.seed)
        chosen = torch.stack(words).gather(0, (times & 3).expand(words[0].shape)[None])[0]
        return chosen >> (32 - BITS)

    def uniform(self, stream: int, times: Tensor, count: int) -> Tensor:
        """Uniform in [0, 1): float64 [T, B, count]."""
        return self.bits(stream, times, count).double() / (1 << BITS)

    def at_start(self, stream: int, count: int) -> Tensor:
        """Uniform in [0, 1) for what is drawn once, when a trial is made: float64 [B, count]."""
        return self.uniform(stream, torch.zeros(1, dtype=torch.int64, device=self.trials.device), count)[0]


def whole_between(uniform: Tensor, least: int, most: int) -> Tensor:
    """Whole numbers in [least, most] from numbers uniform in [0, 1), int64."""
    return least + (uniform * (most - least + 1)).long()


def bell(one: Tensor, two: Tensor, three: Tensor, four: Tensor) -> Tensor:
    """A whole number that is nearly normally distributed, from four 24-bit draws: the sum of their twelve bytes.

    Its mean is 0 and its standard deviation `BELL_SPREAD`, both exactly; its excess kurtosis is -0.1, and it stays
    within 5.98 standard deviations. There is no rounding and no function of a library in it.
    """
    return bytes_of(one) + bytes_of(two) + bytes_of(three) + bytes_of(four) - BELL_MIDDLE


def bytes_of(draw: Tensor) -> Tensor:
    """The sum of the three bytes of a 24-bit draw."""
    return (draw & 255) + ((draw >> 8) & 255) + (draw >> 16)


def poisson_thresholds(mean: float) -> Tensor:
    """Thresholds of the inverse distribution function, int64 [K]: a draw is how many are <= the bits.

    Cumulative probabilities are rounded up to a multiple of 2**-24; larger counts than K never occur.
    """
    thresholds = []
    probability = exp_of(-mean)
    cumulative = probability
    for count in range(1, 10_000):
        threshold = math.ceil(cumulative * (1 << BITS))
        if threshold >= 1 << BITS:
            break
        thresholds.append(threshold)
        probability *= mean / count
        cumulative += probability
    return torch.tensor(thresholds, dtype=torch.int64)


def count_up(count: Tensor, draw: Tensor, threshold: Tensor) -> Tensor:
    """One more where a draw reaches a threshold."""
    return torch.where(draw >= threshold, count + 1, count)


def poisson(bits: Tensor, thresholds: Tensor) -> Tensor:
    """Poisson counts from 24-bit draws, by inversion: how many thresholds each reaches; same shape, int64."""
    counts = torch.zeros_like(bits)
    for threshold in thresholds:
        counts = count_up(counts, bits, threshold)
    return counts


def poisson_table_size(largest: float) -> int:
    """Counts from this one on have probabilities far below 2**-24 for means up to `largest`."""
    return int(largest + 12 * math.sqrt(largest) + 12)


def poisson_of_means(bits: Tensor, means: Tensor, largest: float) -> Tensor:
    """Poisson counts for means that differ between trials.

    Args:
        bits: int64 [B, n], 24-bit draws.
        means: float64 [B], each at most `largest`.
        largest: sizes the table; must be below 700 (where exp(-mean) underflows).
    """
    ratio = means[:, None] / torch.arange(1, poisson_table_size(largest), device=means.device)
    first = exp(-means)[:, None]
    pmf = torch.cat([first, first * torch.cumprod(ratio, 1)], 1)
    return torch.searchsorted(torch.cumsum(pmf, 1), bits.double() / (1 << BITS), right=True)
