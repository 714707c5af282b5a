"""Exponential, sine, cosine and square root in operations whose result IEEE 754 fixes: the same bits on every machine.

Those of a processor maker's library differ in the last bit from machine to machine, and one bit in a table is
another trial in the end. Elementwise, for float64 tensors; compiled, for float64 numbers.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

# ln 2 and pi / 2, each as a number of few bits, whose multiples are exact, and the rest
LN2, LN2_REST = 6.93147180369123816490e-01, 1.90821492927058770002e-10
QUARTER, QUARTER_REST = 1.57079632673412561417, 6.07710050650619224932e-11
LOG2_E = 1.4426950408889634
SPLIT = 134217729.0  # 2^27 + 1, by which a float64 falls into two halves (T. J. Dekker, 1971)
LOWEST, HIGHEST = -708.0, 709.0  # beyond them the exponential is no normal float64
POWERS = tuple((float(n), math.ldexp(1.0, n), math.ldexp(1.0, -n)) for n in (512, 256, 128, 64, 32, 16, 8, 4, 2, 1))
# Taylor's coefficients, the last first; the next term is below 2^-56 of the sum where they are used
EXPONENTIAL = tuple(1 / math.factorial(k) for k in range(14, -1, -1))
SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(9, -1, -1))
COSINE = tuple((-1) ** k / math.factorial(2 * k) for k in range(9, -1, -1))


def exp(x: Tensor) -> Tensor:
    """e to the x; 0 where that is no normal float64, e^709 for more."""
    within = torch.clamp(x, LOWEST, HIGHEST)
    n = torch.floor(within * LOG2_E + 0.5)
    value = _series(EXPONENTIAL, (within - n * LN2) - n * LN2_REST)
    for power, up, down in POWERS:  # value times 2 to the n
        value = torch.where(n >= power, value * up, torch.where(n <= -power, value * down, value))
        n = torch.where(n >= power, n - power, torch.where(n <= -power, n + power, n))
    return torch.where(x < LOWEST, 0.0, value)


def sin(x: Tensor) -> Tensor:
    """Of an angle (rad) of not more than some thousand turns."""
    return _sine(x, 0.0)


def cos(x: Tensor) -> Tensor:
    """Of an angle (rad) of not more than some thousand turns."""
    return _sine(x, 1.0)


def _sine(x: Tensor, ahead: float) -> Tensor:
    """Sine of x and `ahead` right angles."""
    n = torch.floor(x / (QUARTER + QUARTER_REST) + 0.5)
    rest = (x - n * QUARTER) - n * QUARTER_REST
    square = rest * rest
    sine, cosine = rest * _series(SINE, square), _series(COSINE, square)
    n = n + ahead
    quarter = n - 4.0 * torch.floor(0.25 * n)
    value = torch.where((quarter == 0.0) | (quarter == 2.0), sine, cosine)
    return torch.where(quarter >= 2.0, -value, value)


def square_root(x: Tensor) -> Tensor:
    """Square root, correctly rounded, of 0 or a number between 1e-280 and 1e280.

    That of a library, which may be off by a bit, is corrected by what is left of x, computed without rounding.
    """
    root = torch.sqrt(x)
    wide, square = SPLIT * root, root * root
    high = wide - (wide - root)
    low = root - high
    rest = (x - square) - (((high * high - square) + 2.0 * high * low) + low * low)
    return root + torch.where(root > 0.0, rest / torch.where(root > 0.0, 2.0 * root, 1.0), 0.0)


def _series(coefficients: tuple[float, ...], x: Tensor) -> Tensor:
    value = 0.0 * x
    for coefficient in coefficients:
        value = value * x + coefficient
    return value


def exp_of(x: float) -> float:
    """`exp` of a number."""
    return float(exp(torch.tensor(x, dtype=torch.float64)))
