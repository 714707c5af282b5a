"""The random numbers of `snnrl.model.draws`, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

from snnrl.model import draws

MULTIPLIER_0, MULTIPLIER_1 = np.uint64(draws.MULTIPLIER_0), np.uint64(draws.MULTIPLIER_1)
WEYL_0, WEYL_1 = np.uint64(draws.WEYL_0), np.uint64(draws.WEYL_1)
MASK, WORD = np.uint64(draws.MASK), np.uint64(32)
UNUSED = np.uint64(32 - draws.BITS)
UNIT = 1.0 / (1 << draws.BITS)


@njit(inline="always")
def _round(c0, c1, c2, c3, k0, k1):
    p0, p1 = c0 * MULTIPLIER_0, c2 * MULTIPLIER_1
    return (p1 >> WORD) ^ c1 ^ k0, p1 & MASK, (p0 >> WORD) ^ c3 ^ k1, p0 & MASK


@njit(inline="always")
def _philox(c0, c1, c2, c3, seed):
    k0, k1 = seed & MASK, seed >> WORD
    for _ in range(10):
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, k0, k1)
        k0, k1 = (k0 + WEYL_0) & MASK, (k1 + WEYL_1) & MASK
    return c0, c1, c2, c3


@njit
def bits(seed, stream, trial, time, index):
    """One draw of `Draws.bits`, int64 in [0, 2**24)."""
    words = _philox(uint64(index), uint64(time >> 2), uint64(stream), uint64(trial), seed)
    word = words[0]
    for k in range(1, 4):
        if time & 3 == k:
            word = words[k]
    return np.int64(word >> UNUSED)


@njit
def uniform(seed, stream, trial, time, index):
    """One draw of `Draws.uniform`, float64 in [0, 1)."""
    return bits(seed, stream, trial, time, index) * UNIT


@njit
def _fill_rows(out, width, seed, stream, trial, block):
    """Four rows, those of the times 4 * block to 4 * block + 3."""
    row0, row1 = out[:width], out[width : 2 * width]
    row2, row3 = out[2 * width : 3 * width], out[3 * width : 4 * width]
    for i in range(width):
        w0, w1, w2, w3 = _philox(uint64(i), uint64(block), uint64(stream), uint64(trial), seed)
        row0[i] = np.int32(w0 >> UNUSED)
        row1[i] = np.int32(w1 >> UNUSED)
        row2[i] = np.int32(w2 >> UNUSED)
        row3[i] = np.int32(w3 >> UNUSED)


@njit
def fill_bits(out, width, seed, stream, trial, time, steps):
    """Rows of draws for `steps` ms from `time` into flat int32 `out`, `width` a row.

    The first row is that of the multiple of four at or before `time`; that many rows are returned.
    """
    at = 0
    for block in range(time >> 2, ((time + steps - 1) >> 2) + 1):
        _fill_rows(out[at : at + 4 * width], width, seed, stream, trial, block)
        at += 4 * width
    return time & 3
