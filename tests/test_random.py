"""Counter-based random numbers: known answers, distributions, owners, and the compiled copy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers import compiled
from scipy import stats

from snnrl.engines.fused.draws import add_gaussian, add_kicks, bits, fill_counts, fill_noise, uniform
from snnrl.engines.fused.poisson import look_up, poisson_table, room
from snnrl.engines.fused.vectors import DRAWN, load_drawn, store
from snnrl.model.draws import (
    BELL_DRAWS,
    BELL_MIDDLE,
    BELL_SPREAD,
    BITS,
    Draws,
    bell,
    bytes_of,
    philox,
    poisson,
    poisson_of_means,
    poisson_thresholds,
    stream,
)
from snnrl.model.neurons import gaussian_noise, kicked, uniform_noise

# Random123, kat_vectors, philox4x32 10: counter, key, answer
KNOWN = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]
P = 1e-3  # every test of a distribution has a fixed seed and must not be rejected at this level


def words(text: str) -> list[int]:
    return [int(word, 16) for word in text.split()]


def seed_of(key: str) -> int:
    low, high = words(key)
    return low | high << 32


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
def test_philox_gives_the_known_answers(counter: str, key: str, answer: str) -> None:
    c0, c1, c2, c3 = (torch.tensor([word]) for word in words(counter))
    assert [int(word) for word in philox((c0, c1, c2, c3), seed_of(key))] == words(answer)


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
@pytest.mark.parametrize("word", range(4))
def test_compiled_bits_are_the_top_of_the_known_answers(counter: str, key: str, answer: str, word: int) -> None:
    """Counter words are index, time / 4, stream and trial; the time's remainder chooses the word."""
    index, time, name, trial = words(counter)
    found = compiled(bits)(seed_of(key), name, trial, 4 * time + word, index)
    assert found == words(answer)[word] >> 8


@pytest.mark.parametrize("word", range(4))
def test_bits_are_the_top_of_the_known_answer(word: int) -> None:
    draws = Draws(0, torch.tensor([0]))
    assert int(draws.bits(0, torch.tensor([word]), 1)) == words(KNOWN[0][2])[word] >> 8


@pytest.mark.parametrize("seed", [0, 12345, 2**63 - 1])
def test_compiled_draws_equal_the_reference(seed: int) -> None:
    trials, times, name = [0, 3, 2**31 + 5], [0, 1, 2, 3, 4, 70, 1023, 5_000_000_001], stream("a", "b")
    draws = Draws(seed, torch.tensor(trials))
    drawn, numbers = (f(name, torch.tensor(times), 6) for f in (draws.bits, draws.uniform))
    one_bits, one_uniform = compiled(bits), compiled(uniform)
    for t, time in enumerate(times):
        for b, trial in enumerate(trials):
            for i in range(6):
                owner = (seed, name, trial, time, i)
                assert one_bits(*owner) == int(drawn[t, b, i])
                assert one_uniform(*owner) == float(numbers[t, b, i])


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("time", [0, 1, 2, 3, 7, 70_001])
@pytest.mark.parametrize(("size", "steps"), [(1, 1), (5, 2), (8, 3), (20, 70), (3, 101)])
def test_rows_of_noise_equal_the_reference(size: int, steps: int, time: int, real: type) -> None:
    width = (size + 7) // 8 * 8
    out: np.ndarray = np.full((steps + 6) * width, np.nan, real)
    compiled(fill_noise, real)(out, 0, width, size, 7, 99, 4, time, steps, real(3.65), real(0.3))
    assert np.isnan(out.reshape(-1, width)[:, size:]).all()
    rows = out.reshape(-1, width)[time & 3 :][:steps, :size]
    draw = Draws(7, torch.tensor([4])).uniform(99, time + torch.arange(steps), size)[:, 0]
    expected = uniform_noise(draw.to(torch.float32 if real is np.float32 else torch.float64), 3.65, real(0.3))
    assert np.array_equal(rows, expected.numpy())


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("time", [0, 2, 3, 70_001])
@pytest.mark.parametrize(("size", "steps"), [(1, 1), (5, 2), (8, 3), (20, 70)])
def test_rows_of_gaussian_currents_and_of_kicks_equal_the_reference(
    size: int, steps: int, time: int, real: type
) -> None:
    """Both are added to what is there."""
    width = (size + 7) // 8 * 8
    out: np.ndarray = np.full((steps + 6) * width, 3.65, real)
    below = 1 << BITS - 2
    compiled(add_gaussian, real)(out, 0, width, size, 7, 98, 4, time, steps, real(0.3 / BELL_SPREAD))
    compiled(add_kicks, real)(out, 0, width, size, 7, 99, 4, time, steps, real(2.5), below)
    rows = out.reshape(-1, width)
    assert (rows[:, size:] == real(3.65)).all()
    draws, times = Draws(7, torch.tensor([4])), time + torch.arange(steps)
    bits = draws.bits(98, times, BELL_DRAWS * size)[:, 0].view(steps, BELL_DRAWS, size)
    dtype = torch.float32 if real is np.float32 else torch.float64
    start = torch.full((steps, size), 3.65, dtype=dtype)
    expected = gaussian_noise(start, bell(*bits.unbind(1)).to(dtype), real(0.3 / BELL_SPREAD))
    kicks = draws.bits(99, times, size)[:, 0]
    expected = kicked(expected, kicks, below, 2.5)
    assert np.array_equal(rows[time & 3 :][:steps, :size], expected.numpy())
    assert size * steps < 20 or 0 < int((kicks < below).sum()) < size * steps


def test_three_bytes_of_all_draws_have_exactly_their_mean_and_variance() -> None:
    """So `bell`, of four of them, has mean 0 and variance 65535."""
    every = torch.arange(1 << BITS)
    total = bytes_of(every)
    assert 4 * int(total.sum()) == BELL_MIDDLE << BITS
    squares = int((total * total).sum()) / (1 << BITS)
    assert 4 * (squares - (BELL_MIDDLE / 4) ** 2) == 65535.0 == round(BELL_SPREAD**2, 9)
    for draw in (0, 255, 256, 0xABCDEF, (1 << BITS) - 1):
        assert int(total[draw]) == sum(draw.to_bytes(3, "big"))


def test_bell_is_as_near_to_the_normal_distribution_as_twelve_bytes_are() -> None:
    """Its exact distribution, by convolution; and that the draws have it."""
    probability = np.ones(1)
    for _ in range(12):
        probability = np.convolve(probability, np.full(256, 1 / 256))
    value = (np.arange(len(probability)) - BELL_MIDDLE) / BELL_SPREAD
    assert [float(value[0]), float(value[-1])] == pytest.approx([-5.977, 5.977], abs=1e-3)
    assert float(probability @ value**4) == pytest.approx(3 - 0.1, abs=1e-5)
    assert np.abs(np.cumsum(probability) - 0.5 * probability - stats.norm.cdf(value)).max() < 0.0025
    bits = Draws(3, torch.arange(10)).bits(stream("b"), torch.arange(500), BELL_DRAWS * 20).unflatten(2, (-1, 20))
    drawn = bell(*bits.unbind(2)).flatten()
    assert drawn.dtype == torch.int64
    assert float(drawn.double().mean()) == pytest.approx(0.0, abs=5 * BELL_SPREAD / len(drawn) ** 0.5)
    edges = np.searchsorted(np.cumsum(probability), np.linspace(0, 1, 41)[1:-1])
    found = np.bincount(np.searchsorted(edges, drawn.numpy() + BELL_MIDDLE), minlength=40)
    expected = np.bincount(np.searchsorted(edges, np.arange(len(probability))), probability, minlength=40)
    assert stats.chisquare(found, expected * len(drawn)).pvalue > P


@pytest.mark.parametrize("time", [0, 1, 2, 3, 7, 70_001])
@pytest.mark.parametrize(("size", "steps"), [(1, 1), (5, 2), (8, 3), (20, 70), (3, 101)])
@pytest.mark.parametrize("mean", [0.01, 2.35, 12.0])
def test_rows_of_counts_equal_the_reference(size: int, steps: int, time: int, mean: float) -> None:
    thresholds, stride, at, gain = poisson_thresholds(mean), 41, 3, np.float32(1.7)
    out = np.full(at + steps * stride + 16, -1.0, np.float32)
    compiled(fill_counts, np.float32)(out, at, stride, size, 7, 99, 4, time, steps, thresholds.numpy(), gain)
    found = out[at : at + steps * stride].reshape(steps, stride)
    bits = Draws(7, torch.tensor([4])).bits(99, time + torch.arange(steps), size)[:, 0]
    assert np.array_equal(found[:, :size], gain * poisson(bits, thresholds).numpy().astype(np.float32))
    assert (found[:, size:] == -1.0).all()
    assert (out[:at] == -1.0).all()


def test_at_start_is_the_draw_of_time_zero() -> None:
    draws = Draws(5, torch.arange(3))
    assert torch.equal(draws.at_start(11, 4), draws.uniform(11, torch.tensor([0]), 4)[0])


def test_draws_of_a_trial_do_not_depend_on_the_batch() -> None:
    times = torch.tensor([9, 2, 4097])
    batch = Draws(3, torch.tensor([40, 2, 7])).bits(8, times, 5)
    for place, trial in enumerate([40, 2, 7]):
        assert torch.equal(batch[:, place], Draws(3, torch.tensor([trial])).bits(8, times, 5)[:, 0])


def test_draws_of_a_time_and_an_index_do_not_depend_on_the_others() -> None:
    draws = Draws(3, torch.arange(2))
    long = draws.bits(8, torch.arange(20), 9)
    assert torch.equal(draws.bits(8, torch.tensor([13]), 4)[0], long[13, :, :4])


def test_streams_of_different_owners_differ() -> None:
    names = [stream(*n) for n in (("a",), ("b",), ("a", "b"), ("ab",), ("b", "a"), ("range", "left_food"))]
    assert len(set(names)) == len(names)
    assert all(0 <= name < 2**32 for name in names)


def test_uniform_is_uniform() -> None:
    uniform = Draws(1, torch.arange(10)).uniform(stream("u"), torch.arange(100), 20).flatten().numpy()
    assert uniform.min() >= 0.0
    assert uniform.max() < 1.0
    assert stats.kstest(uniform, "uniform").pvalue > P


def test_low_and_high_bits_are_uniform() -> None:
    bits = Draws(2, torch.arange(10)).bits(stream("u"), torch.arange(100), 20).flatten().numpy()
    for byte in (bits & 255, bits >> BITS - 8):
        assert stats.chisquare(np.bincount(byte, minlength=256)).pvalue > P


@pytest.mark.parametrize("differs", ["seed", "stream", "time", "far time", "trial", "index"])
def test_draws_that_differ_in_one_owner_are_independent(differs: str) -> None:
    times, trials = torch.arange(0, 4000, 4), torch.arange(0, 20, 2)
    first = Draws(0, trials).bits(5, times, 1)
    second = {
        "seed": Draws(1, trials).bits(5, times, 1),
        "stream": Draws(0, trials).bits(6, times, 1),
        "time": Draws(0, trials).bits(5, times + 1, 1),
        "far time": Draws(0, trials).bits(5, times + 4000, 1),
        "trial": Draws(0, trials + 1).bits(5, times, 1),
        "index": Draws(0, trials).bits(5, times, 2)[:, :, 1:],
    }[differs]
    joint = ((first >> BITS - 3) * 8 + (second >> BITS - 3)).flatten()
    assert stats.chi2_contingency(torch.bincount(joint, minlength=64).view(8, 8).numpy()).pvalue > P


def poisson_p(counts: np.ndarray, mean: float) -> float:
    """p of a chi-square test against Poisson(mean), counts pooled so that each bin expects at least 5."""
    low, high = (int(stats.poisson.ppf(q, mean)) for q in (1e-3, 1 - 1e-3))
    observed = np.bincount(np.clip(counts, low, high) - low, minlength=high - low + 1)
    expected = stats.poisson.pmf(np.arange(low, high + 1), mean)
    expected[0], expected[-1] = stats.poisson.cdf(low, mean), stats.poisson.sf(high - 1, mean)
    assert expected.min() * len(counts) >= 5
    return float(stats.chisquare(observed, expected * len(counts)).pvalue)


@pytest.mark.parametrize("mean", [0.5, 2.35, 12.0, 30.0])
def test_poisson_has_its_distribution(mean: float) -> None:
    bits = Draws(3, torch.arange(10)).bits(stream("p"), torch.arange(100), 20).flatten()
    assert poisson_p(poisson(bits, poisson_thresholds(mean)).numpy(), mean) > P


@pytest.mark.parametrize("mean", [0.5, 2.35, 12.0])
def test_poisson_thresholds_are_the_cumulative_probabilities(mean: float) -> None:
    thresholds = poisson_thresholds(mean)
    exact = stats.poisson.cdf(np.arange(len(thresholds)), mean) * 2**BITS
    assert np.all(thresholds.numpy() - exact > -1e-6)
    assert np.all(thresholds.numpy() - exact < 1 + 1e-6)
    assert torch.equal(poisson(thresholds - 1, thresholds), torch.arange(len(thresholds)))
    assert torch.equal(poisson(thresholds, thresholds), torch.arange(1, len(thresholds) + 1))


def test_poisson_of_means_has_its_distribution() -> None:
    means = [0.3, 7.5, 30.0]
    bits = Draws(4, torch.arange(3)).bits(stream("p"), torch.arange(1000), 20)
    bits = bits.transpose(0, 1).reshape(3, -1)
    counts = poisson_of_means(bits, torch.tensor(means, dtype=torch.float64), 30.0)
    for row, mean in zip(counts.numpy(), means, strict=True):
        assert poisson_p(row, mean) > P


def test_poisson_of_mean_zero_is_zero() -> None:
    bits = torch.tensor([[0, 1, 2**BITS - 1]])
    assert poisson_of_means(bits, torch.zeros(1, dtype=torch.float64), 30.0).tolist() == [[0, 0, 0]]


@pytest.mark.parametrize("mean", [0.0, 1e-3, 0.7, 7.3, 29.99, 30.0])
def test_compiled_table_counts_as_the_reference(mean: float) -> None:
    bits = Draws(6, torch.arange(1)).bits(stream("p"), torch.arange(200), 20).view(1, -1)
    lowest, highest = torch.arange(8)[None], torch.arange(2**BITS - 2**15, 2**BITS)[None]
    bits = torch.cat([bits, lowest, highest], 1)
    expected = poisson_of_means(bits, torch.tensor([mean], dtype=torch.float64), 30.0)[0]
    table, counts = np.zeros(room(30.0)), np.zeros(bits.shape[1], np.int64)
    compiled(poisson_table)(mean, table)
    compiled(look_up_all)(table, bits[0].numpy(), counts)
    assert np.array_equal(counts, expected.numpy())
    assert np.array_equal(counts, np.searchsorted(table, bits[0].numpy() / 2**BITS, side="right"))


def look_up_all(table, drawn, counts):  # type: ignore[no-untyped-def]
    for index in range(0, len(drawn), DRAWN):
        store(counts, index, look_up(table, load_drawn(drawn, index)))  # type: ignore[call-arg]
