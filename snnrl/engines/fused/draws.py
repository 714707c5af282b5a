"""The random numbers of `snnrl.model.draws`, one at a time and for many ms at once."""

from __future__ import annotations

from snnrl.engines.fused.vectors import DRAWN, as_real, counting, select, store
from snnrl.model.draws import BITS, MASK, philox, reached
from snnrl.model.neurons import uniform_noise

UNUSED = 32 - BITS
UNIT = 2.0**-BITS


def bits(seed, stream, trial, time, index):
    """One draw of `Draws.bits`, in [0, 2^24)."""
    words = philox((index & MASK, (time >> 2) & MASK, stream & MASK, trial & MASK), seed)
    return words[time & 3] >> UNUSED


def uniform(seed, stream, trial, time, index):
    """One draw of `Draws.uniform`, in [0, 1)."""
    return bits(seed, stream, trial, time, index) * UNIT


def drawn_width(size):
    """Draws a row, rounded up to whole vectors."""
    return (size + DRAWN - 1) // DRAWN * DRAWN


def four_times(seed, stream, trial, block, index):
    """Draws of DRAWN indices from `index` on at the times 4 block to 4 block + 3, each a vector in [0, 2^24)."""
    zero = counting(0, DRAWN) * 0
    first = (counting(index, DRAWN) & MASK, zero + (block & MASK), zero + (stream & MASK), zero + (trial & MASK))
    w0, w1, w2, w3 = philox(first, seed)
    return w0 >> UNUSED, w1 >> UNUSED, w2 >> UNUSED, w3 >> UNUSED


def fill_noise(out, at, width, seed, stream, trial, time, steps, current, amplitude):
    """Background currents of `steps` ms from `time` on, `width` a row, into a flat array from `at` on.

    The first row is that of the multiple of four at or before `time`.
    """
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        for index in range(0, width, DRAWN):
            w0, w1, w2, w3 = four_times(seed, stream, trial, block, index)
            here = at + index
            store(out, here, uniform_noise(as_real(w0, current) * UNIT, current, amplitude))
            store(out, here + width, uniform_noise(as_real(w1, current) * UNIT, current, amplitude))
            store(out, here + 2 * width, uniform_noise(as_real(w2, current) * UNIT, current, amplitude))
            store(out, here + 3 * width, uniform_noise(as_real(w3, current) * UNIT, current, amplitude))
        at += 4 * width


def fill_counts(out, at, stride, size, seed, stream, trial, time, steps, thresholds):
    """Poisson counts of `size` neurons, in rows of `steps` ms that are `stride` apart, from `at` on.

    Up to DRAWN - 1 places behind those of the neurons are set to 0.
    """
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        row = 4 * block - time
        for index in range(0, size, DRAWN):
            w0, w1, w2, w3 = four_times(seed, stream, trial, block, index)
            c0, c1 = reached(w0, thresholds[0]), reached(w1, thresholds[0])
            c2, c3 = reached(w2, thresholds[0]), reached(w3, thresholds[0])
            for k in range(1, len(thresholds)):
                threshold = thresholds[k]
                c0, c1 = c0 + reached(w0, threshold), c1 + reached(w1, threshold)
                c2, c3 = c2 + reached(w2, threshold), c3 + reached(w3, threshold)
            mine, here = counting(index, DRAWN) < size, at + index + row * stride
            if row >= 0:
                store(out, here, select(mine, c0, 0.0))
            if 0 <= row + 1 < steps:
                store(out, here + stride, select(mine, c1, 0.0))
            if 0 <= row + 2 < steps:
                store(out, here + 2 * stride, select(mine, c2, 0.0))
            if 0 <= row + 3 < steps:
                store(out, here + 3 * stride, select(mine, c3, 0.0))
