"""The functions whose bits are the same everywhere: against the mathematical library, and their bits."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import torch
from helpers import compiled

from snnrl.model import elementary

FUNCTIONS = {"exp": (-690.0, 690.0), "sin": (-700.0, 700.0), "cos": (-700.0, 700.0)}
BITS = {"exp": "e47808e7c0292623", "sin": "446aaac3667228bc", "cos": "bab5d1e7e6e87f4e"}


def points(name: str) -> torch.Tensor:
    """Evenly spread, by operations that are exact up to one rounding."""
    low, high = FUNCTIONS[name]
    return low + (high - low) / 20_000 * torch.arange(20_001, dtype=torch.float64)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_is_right_to_the_last_bit_or_two(name: str) -> None:
    found = getattr(elementary, name)(points(name)).numpy()
    expected = getattr(np, name)(points(name).numpy())
    unit = np.abs(expected) if name == "exp" else 1.0
    assert np.max(np.abs(found - expected) / unit) < 2 * np.finfo(float).eps


def test_a_square_root_is_correctly_rounded() -> None:
    squares = torch.cat([points("exp").abs() * scale for scale in (1.0, 1e-30, 1e9)])
    found = elementary.square_root(squares).numpy()
    assert np.array_equal(found, np.sqrt(squares.numpy()))  # numpy's is the processor's own
    one = compiled(elementary.square_root)
    assert [one(x) for x in squares[::97].tolist()] == found[::97].tolist()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_has_the_same_bits_on_every_machine_and_compiled(name: str) -> None:
    found = getattr(elementary, name)(points(name)).numpy()
    assert hashlib.sha256(found.tobytes()).hexdigest()[:16] == BITS[name]
    one = compiled(getattr(elementary, name))
    assert [one(x) for x in points(name)[::97].tolist()] == found[::97].tolist()


def test_the_ends_of_the_exponential() -> None:
    assert elementary.exp_of(0.0) == 1.0
    assert elementary.exp_of(-1e12) == elementary.exp_of(-708.5) == 0.0
    assert 0.0 < elementary.exp_of(-708.0) < 1e-300
    assert elementary.exp_of(1e12) == elementary.exp_of(709.0) == pytest.approx(8.2184e307, rel=1e-4)
