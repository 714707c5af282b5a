"""The random numbers of `snnrl.model.draws`, one at a time and for many neurons and ms at once."""

from __future__ import annotations

from snnrl.engines.fused.vectors import DRAWN, as_real, counting, half, joined, load_drawn, mask_bits, select, store
from snnrl.model.draws import BITS, MASK, bell, count_up, philox
from snnrl.model.neurons import gaussian_noise, kicked, uniform_noise

UNUSED = 32 - BITS
UNIT = 2.0**-BITS
OFTEN = 8  # thresholds that every draw is compared with; where the mean is small, it is rare that one reaches more


def bits(seed, stream, trial, time, index):
    """One draw of `Draws.bits`, in [0, 2^24)."""
    counter = int(index) & MASK, int(time >> 2) & MASK, int(stream) & MASK, int(trial) & MASK
    words = philox(counter, int(seed))
    return words[time & 3] >> UNUSED


def uniform(seed, stream, trial, time, index):
    """One draw of `Draws.uniform`, in [0, 1)."""
    return bits(seed, stream, trial, time, index) * UNIT


def four_times(seed, stream, trial, block, index):
    """Draws of DRAWN indices from `index` on at the times 4 block to 4 block + 3, each a vector in [0, 2^24)."""
    zero = counting(0, DRAWN) * 0
    first = (counting(index, DRAWN) & MASK, zero + (block & MASK), zero + (stream & MASK), zero + (trial & MASK))
    w0, w1, w2, w3 = philox(first, seed)
    return w0 >> UNUSED, w1 >> UNUSED, w2 >> UNUSED, w3 >> UNUSED


def fill_bits(out, size, seed, stream, trial, time):
    """Draws of `size` indices at one time; up to DRAWN - 1 more are made."""
    for index in range(0, size, DRAWN):
        w0, w1, w2, w3 = four_times(seed, stream, trial, time >> 2, index)
        if time & 2:
            store(out, index, w3 if time & 1 else w2)
        else:
            store(out, index, w1 if time & 1 else w0)


def replace(out, at, mine, value):
    """Put those lanes of a vector that are `mine` into an array."""
    store(out, at, select(mine, value, load_drawn(out, at)))


def fill_noise(out, at, stride, size, seed, stream, trial, time, steps, current, amplitude):
    """Background currents of `size` neurons, in rows of `steps` ms that are `stride` apart, from `at` on.

    The first row is that of the multiple of four at or before `time`.
    """
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        for index in range(0, size, DRAWN):
            w0, w1, w2, w3 = four_times(seed, stream, trial, block, index)
            mine, here = counting(index, DRAWN) < size, at + index
            replace(out, here, mine, uniform_noise(as_real(w0, current) * UNIT, current, amplitude))
            replace(out, here + stride, mine, uniform_noise(as_real(w1, current) * UNIT, current, amplitude))
            replace(out, here + 2 * stride, mine, uniform_noise(as_real(w2, current) * UNIT, current, amplitude))
            replace(out, here + 3 * stride, mine, uniform_noise(as_real(w3, current) * UNIT, current, amplitude))
        at += 4 * stride


def bells(seed, stream, trial, block, index, size):
    """Four draws of `bell` like those of `four_times`; `size` indices come between two of the draws for one of them."""
    a0, a1, a2, a3 = four_times(seed, stream, trial, block, index)
    b0, b1, b2, b3 = four_times(seed, stream, trial, block, index + size)
    c0, c1, c2, c3 = four_times(seed, stream, trial, block, index + 2 * size)
    d0, d1, d2, d3 = four_times(seed, stream, trial, block, index + 3 * size)
    return bell(a0, b0, c0, d0), bell(a1, b1, c1, d1), bell(a2, b2, c2, d2), bell(a3, b3, c3, d3)


def add_gaussian(out, at, stride, size, seed, stream, trial, time, steps, scale):
    """Add Gaussian currents to those that `fill_noise` has filled; the rest as there."""
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        for index in range(0, size, DRAWN):
            b0, b1, b2, b3 = bells(seed, stream, trial, block, index, size)
            mine, here = counting(index, DRAWN) < size, at + index
            replace(out, here, mine, gaussian_noise(load_drawn(out, here), as_real(b0, scale), scale))
            here += stride
            replace(out, here, mine, gaussian_noise(load_drawn(out, here), as_real(b1, scale), scale))
            here += stride
            replace(out, here, mine, gaussian_noise(load_drawn(out, here), as_real(b2, scale), scale))
            here += stride
            replace(out, here, mine, gaussian_noise(load_drawn(out, here), as_real(b3, scale), scale))
        at += 4 * stride


def add_kicks(out, at, stride, size, seed, stream, trial, time, steps, kick, below):
    """Add kicks to the currents that `fill_noise` has filled; the rest as there."""
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        for index in range(0, size, DRAWN):
            w0, w1, w2, w3 = four_times(seed, stream, trial, block, index)
            mine, here = counting(index, DRAWN) < size, at + index
            replace(out, here, mine, kicked(load_drawn(out, here), w0, below, kick))
            here += stride
            replace(out, here, mine, kicked(load_drawn(out, here), w1, below, kick))
            here += stride
            replace(out, here, mine, kicked(load_drawn(out, here), w2, below, kick))
            here += stride
            replace(out, here, mine, kicked(load_drawn(out, here), w3, below, kick))
        at += 4 * stride


def fill_counts(out, at, stride, size, seed, stream, trial, time, steps, thresholds, gain):
    """Poisson counts of `size` neurons times `gain`, in rows of `steps` ms that are `stride` apart, from `at` on."""
    often = min(len(thresholds), OFTEN)
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        row = 4 * block - time
        for index in range(0, size, DRAWN):
            w0, w1, w2, w3 = four_times(seed, stream, trial, block, index)
            early, late = joined(w0, w1), joined(w2, w3)
            c01, c23 = early - early, late - late
            for threshold in thresholds[:often]:
                c01, c23 = count_up(c01, early, threshold), count_up(c23, late, threshold)
            if often < len(thresholds) and mask_bits((early >= thresholds[often]) | (late >= thresholds[often])):
                for threshold in thresholds[often:]:
                    c01, c23 = count_up(c01, early, threshold), count_up(c23, late, threshold)
            mine, here = counting(index, DRAWN) < size, at + index + row * stride
            if row >= 0:
                replace(out, here, mine, as_real(half(c01, 0), out) * gain)
            if 0 <= row + 1 < steps:
                replace(out, here + stride, mine, as_real(half(c01, 1), out) * gain)
            if 0 <= row + 2 < steps:
                replace(out, here + 2 * stride, mine, as_real(half(c23, 0), out) * gain)
            if 0 <= row + 3 < steps:
                replace(out, here + 3 * stride, mine, as_real(half(c23, 1), out) * gain)
