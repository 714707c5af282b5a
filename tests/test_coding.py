"""From sensor values to currents and from spikes to wheel speeds; whole ticks in every engine."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import ENGINES, SURE, group_of, make_simulation, place
from scipy import stats
from torch import Tensor

from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws, poisson, poisson_of_means, poisson_thresholds, stream
from snnrl.simulation import Simulation

P = 1e-3  # every test of a distribution has a fixed seed and must not be rejected at this level
TICK = 70
FOOD_ONLY = ("+experiment=food_attraction", "seconds=1")


def food_only(trials: int, *overrides: str) -> Simulation:
    return make_simulation(*FOOD_ONLY, f"trials={trials}", *overrides)


def span(simulation: Simulation, group: str) -> slice:
    return group_of(simulation.network, group).span


def currents(simulation: Simulation, values: list[list[float]], touched: list[bool] | None = None) -> Tensor:
    """A tick's currents for the values of the left and right food sensor, [tick, B, N]."""
    felt = torch.tensor(touched or [False] * len(values))
    value = torch.tensor(values, dtype=torch.float64)
    return simulation.situation.coding.encode(simulation.network, {"food": value}, {"food": felt})


@pytest.mark.parametrize(
    ("left", "right", "speeds"),
    [
        (0, 0, [28.1, 28.1]),
        (9, 9, [28.1, 28.1]),
        (1, 0, [31.2, 25.0]),
        (40, 39, [31.2, 25.0]),
        (0, 1, [25.0, 31.2]),
        (3, 300, [25.0, 31.2]),
    ],
)
def test_wheel_speeds_are_winner_takes_all(left: int, right: int, speeds: list[float]) -> None:
    simulation = food_only(1)
    names = list(simulation.network.groups)
    simulation.network.spike_count.fill_(1000)  # of other groups, which must not count
    simulation.situation.coding.decoded.fill_(1000)
    simulation.network.spike_count[0, names.index("left_motor")] += left
    simulation.network.spike_count[0, names.index("right_motor")] += right
    assert simulation.situation.coding.decode(simulation.network)[0].tolist() == pytest.approx(speeds, abs=1e-12)


@pytest.mark.parametrize(
    ("left", "right", "lead"), [(0, 0, 0.0), (9, 9, 0.0), (1, 0, 1.0), (0, 7, -1.0), (30, 10, 0.5), (1, 4, -0.6)]
)
def test_without_a_winner_wheels_go_by_the_motors_shares(left: int, right: int, lead: float) -> None:
    simulation = food_only(1, "coding.wheels=share")
    names = list(simulation.network.groups)
    simulation.network.spike_count[0, names.index("left_motor")] += left
    simulation.network.spike_count[0, names.index("right_motor")] += right
    found = simulation.situation.coding.decode(simulation.network)[0].tolist()
    assert found == pytest.approx([28.1 + 3.1 * lead, 28.1 - 3.1 * lead], abs=1e-12)


def test_only_spikes_since_the_last_tick_count() -> None:
    simulation = food_only(2)
    names = list(simulation.network.groups)
    motors = [names.index("left_motor"), names.index("right_motor")]
    totals = [[[50, 10], [0, 0]], [[52, 15], [1, 0]], [[52, 15], [1, 1]], [[60, 23], [4, 4]]]
    expected = [
        [[31.2, 25.0], [28.1, 28.1]],
        [[25.0, 31.2], [31.2, 25.0]],
        [[28.1, 28.1], [25.0, 31.2]],
        [[28.1, 28.1], [28.1, 28.1]],
    ]
    for total, speeds in zip(totals, expected, strict=True):
        simulation.network.spike_count[:, motors] = torch.tensor(total)
        found = simulation.situation.coding.decode(simulation.network)
        assert torch.allclose(found, torch.tensor(speeds, dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("left", "right", "turn"), [(3, 2, -0.434), (2, 3, 0.434), (2, 2, 0.0), (0, 0, 0.0), (0, 20, 0.434)]
)
def test_the_robot_turns_by_the_spikes_of_the_last_tick(left: int, right: int, turn: float, engine: str) -> None:
    """More spikes on the left: the left wheel is faster and the robot turns to the right."""
    simulation = food_only(1)
    place(simulation.situation.world, (50.0, 50.0), 3.0, [[1.0, 1.0]] * 20)
    machine = make_engine(engine, "cpu", 1)
    injected = torch.zeros(TICK, 1, simulation.network.size, dtype=torch.float64)
    for group, count in (("left_motor", left), ("right_motor", right)):
        start = span(simulation, group).start
        injected[30, 0, start : start + count] = SURE
    machine.run_network(simulation.network, injected)
    simulation.run(machine, 1)
    assert float(simulation.situation.world.heading) == pytest.approx(3.0 + turn, abs=1e-12)


def test_a_range_pulse_lasts_1_ms_and_drives_only_the_answering_side() -> None:
    simulation = food_only(30)
    current = currents(simulation, [[0.8, 0.0]] * 15 + [[0.0, 0.8]] * 15)
    left, right = (current[:, :, span(simulation, group)] for group in ("left_food", "right_food"))
    for side, answering in ((left, slice(0, 15)), (right, slice(15, 30))):
        silent = slice(15, 30) if answering.start == 0 else slice(0, 15)
        assert float(side[1:].abs().max()) == 0.0
        assert float(side[0, silent].abs().max()) == 0.0
        assert bool((side[0, answering] > 0).all())
        mean = float(side[0, answering].mean()) / simulation.situation.coding.config.range_gain
        assert mean == pytest.approx(24.0, abs=5 * math.sqrt(24.0 / 300))  # 30 x 0.8, five standard errors
    assert len(left[0, 0].unique()) > 5


def test_a_range_pulse_is_the_poisson_count_of_its_neuron_times_the_gain() -> None:
    simulation = food_only(3, "coding.range_gain=1.75", "seed=9", "trial_start=4")
    simulation.network.time.fill_(7 * TICK)
    current = currents(simulation, [[0.0, 0.3], [0.0, 1.0], [0.0, 0.01]])
    bits = Draws(9, torch.arange(4, 7)).bits(stream("range", "right_food"), torch.tensor([490]), 20)[0]
    means = torch.tensor([9.0, 30.0, 0.3], dtype=torch.float64)
    expected = 1.75 * poisson_of_means(bits, means, 30.0).double()
    assert torch.equal(current[0, :, span(simulation, "right_food")], expected)


def test_a_range_sensors_current_is_the_same_in_every_ms_and_for_every_neuron() -> None:
    simulation = food_only(2, "coding.range_current=8", "coding.range_gain=0")
    current = currents(simulation, [[0.25, 0.0], [0.5, 1.0]])
    for trial, values in enumerate([[2.0, 0.0], [4.0, 8.0]]):
        for group, value in zip(("left_food", "right_food"), values, strict=True):
            assert current[:, trial, span(simulation, group)].unique().tolist() == [value]


def test_a_touch_pulse_lasts_1_ms_and_drives_only_the_trial_that_touched() -> None:
    simulation = food_only(3, "coding.touch_gain=2.25", "seed=9")
    current = currents(simulation, [[0.0, 0.0]] * 3, [True, False, True])[:, :, span(simulation, "food_touch")]
    bits = Draws(9, torch.arange(3)).bits(stream("touch", "food_touch"), torch.tensor([0]), 20)[0]
    counts = poisson(bits, poisson_thresholds(12.0)).double()
    assert torch.equal(current[0], 2.25 * counts * torch.tensor([[1.0], [0.0], [1.0]], dtype=torch.float64))
    assert float(current[1:].abs().max()) == 0.0
    assert float(counts.mean()) == pytest.approx(12.0, abs=5 * math.sqrt(12.0 / 60))


@pytest.mark.parametrize("gain", [2.0, 0.0])
def test_a_gain_on_the_mean_makes_poisson_pulses_of_the_larger_mean(gain: float) -> None:
    """Their variance is then their mean, not the gain times that."""
    gains = (f"coding.range_gain={gain}", f"coding.touch_gain={gain}")
    simulation = food_only(200, "seed=9", "coding.gain_acts_on=mean", *gains)
    current = currents(simulation, [[0.5, 0.0]] * 200, [True] * 200)[0]
    draws = Draws(9, torch.arange(200))
    for group, mean in (("left_food", 15.0 * gain), ("food_touch", 12.0 * gain)):
        kind = "touch" if group == "food_touch" else "range"
        bits = draws.bits(stream(kind, group), torch.tensor([0]), 20)[0]
        pulse = current[:, span(simulation, group)]
        assert torch.equal(pulse, poisson(bits, poisson_thresholds(mean)).double())
        assert float(pulse.mean()) == pytest.approx(mean, abs=5 * math.sqrt(mean / 4000))
        assert float(pulse.var()) == pytest.approx(mean, rel=0.12)


@pytest.mark.parametrize("kind", ["range", "touch"])
def test_a_gain_on_the_mean_is_refused_where_no_table_reaches(kind: str) -> None:
    most = {"range": 20, "touch": 50}[kind]  # times the means of 30 and 12
    food_only(1, "coding.gain_acts_on=mean", f"coding.{kind}_gain={most}")
    with pytest.raises(ConfigError, match=rf"coding\.{kind}_gain=51.*must be at most 600"):
        food_only(1, "coding.gain_acts_on=mean", f"coding.{kind}_gain=51")
    food_only(1, f"coding.{kind}_gain=51")


def test_exploration_drives_exactly_one_side_for_the_whole_tick() -> None:
    simulation = food_only(50, "coding.exploration_gain=1")
    chosen = []
    for tick in range(6):
        simulation.network.time.fill_(tick * TICK)
        current = currents(simulation, [[0.0, 0.0]] * 50)
        left, right = (current[:, :, span(simulation, group)] for group in ("left_motor", "right_motor"))
        left_drives, right_drives = (side.any(2).sum(0) for side in (left, right))  # ms of [B]
        assert torch.equal(left_drives == 0, right_drives > 0)
        assert torch.equal(left_drives > 0, left_drives == TICK)
        assert torch.equal(right_drives > 0, right_drives == TICK)
        chosen.append(right_drives > 0)
        driven = torch.where(chosen[-1][None, :, None], right, left)
        assert float(driven.mean()) == pytest.approx(2.35, abs=5 * math.sqrt(2.35 / driven.numel()))
        assert float(driven.var()) == pytest.approx(2.35, abs=0.1)
        current[:, :, span(simulation, "left_motor")] = current[:, :, span(simulation, "right_motor")] = 0.0
        assert float(current.abs().max()) == 0.0
    sides = torch.stack(chosen)
    assert stats.binomtest(int(sides.sum()), sides.numel()).pvalue > P
    assert 0 < int((sides[0] != sides[1]).sum()) < 50


def test_exploration_is_drawn_anew_every_ms_and_for_every_neuron() -> None:
    simulation = food_only(1)
    current = currents(simulation, [[0.0, 0.0]])[:, 0]
    motors = [current[:, span(simulation, group)] for group in ("left_motor", "right_motor")]
    driven = motors[0] if bool(motors[0].any()) else motors[1]
    assert len(driven.unique(dim=0)) == TICK
    assert len(driven.unique(dim=1)[0]) == 20


def explored(simulation: Simulation) -> tuple[Tensor, str]:
    """A tick's current of the motor that explores, [tick, n], in the first trial; and which that is."""
    current = currents(simulation, [[0.0, 0.0]] * simulation.trials)[:, 0]
    (motor,) = (name for name in ("left_motor", "right_motor") if bool(current[:, span(simulation, name)].any()))
    return current[:, span(simulation, motor)], motor


@pytest.mark.parametrize("gain", [1.45, 0.0])
def test_the_exploration_gain_is_a_factor_on_its_counts(gain: float) -> None:
    plain, scaled = (food_only(1, "seed=4", f"coding.exploration_gain={factor}") for factor in (1.0, gain))
    counts, motor = explored(plain)
    current = currents(scaled, [[0.0, 0.0]])[:, 0, span(scaled, motor)]
    assert torch.equal(current, gain * counts)
    assert float(counts.sum()) > 3000


def test_exploration_that_is_held_is_one_count_a_neuron_and_tick() -> None:
    simulation = food_only(1, "seed=4", "coding.exploration_drawn=each_tick", "coding.exploration_gain=1.5")
    held = []
    for tick in range(60):
        simulation.network.time.fill_(tick * TICK)
        current, motor = explored(simulation)
        bits = Draws(4, torch.arange(1)).bits(stream("exploration", motor), torch.tensor([tick * TICK]), 20)[0, 0]
        expected = 1.5 * poisson(bits, poisson_thresholds(2.35)).double()
        assert torch.equal(current, expected.expand(TICK, 20))
        held.append(expected / 1.5)
    counts = torch.stack(held)
    assert float(counts.mean()) == pytest.approx(2.35, abs=5 * math.sqrt(2.35 / counts.numel()))
    assert float(counts.var()) == pytest.approx(2.35, rel=0.2)


WITHOUT_WINNERS = ("coding.wheels=share", "world.ranges.food.answers=both", "coding.range_current=6")


@pytest.mark.parametrize("tick", [70, 130])
@pytest.mark.parametrize("options", [(), WITHOUT_WINNERS])
def test_engines_agree_on_a_tick_with_every_kind_of_current(tick: int, options: tuple[str, ...]) -> None:
    """Food on either side, in touch and out of sight; a tick longer than a block of the fused engine too."""
    states, rasters = [], []
    for engine in ENGINES:
        simulation = food_only(5, f"coding.tick={tick}", "seed=2", *options)
        far = [[20.0, 80.0]] * 19
        for trial, item in enumerate(([60.0, 52.0], [60.0, 45.0], [53.0, 50.0], [30.0, 50.0], [75.0, 50.0])):
            place(simulation.situation.world, (50.0, 50.0), 0.0, [item, *far], trial=trial)
        raster = torch.zeros(3 * tick, 5, simulation.network.size, dtype=torch.bool)
        simulation.run(make_engine(engine, "cpu", 1), 3, raster)
        assert simulation.situation.world.touches[:, 0].tolist()[2] >= 1
        assert int(simulation.network.time) == 3 * tick
        states.append(simulation.state_dict())
        rasters.append(raster)
    assert torch.equal(*rasters)
    assert int(rasters[0].sum()) > 100
    for key, value in states[0].items():
        assert torch.allclose(value.double(), states[1][key].double(), rtol=0, atol=1e-9), key


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_burst_lowers_dopamine_after_a_touch_of_poison(sign: int, engine: str) -> None:
    """A burst of 20, released in the first ms, has decayed for 69 ms at the end of the tick."""
    calm = "network.groups.dopaminergic.current=0"  # else all of them fire once, from the initial state
    simulation = food_only(1, calm)
    simulation.situation.world.sign.fill_(sign)
    dopamine = simulation.network.dopamine
    assert dopamine is not None
    dopamine.pending[0, 0, 0] = 20
    simulation.run(make_engine(engine, "cpu", 1), 1)
    expected = dopamine.baseline + sign * 20 * dopamine.values["release"] * math.exp(-69 / dopamine.tau)
    assert float(dopamine.level) == pytest.approx(expected, rel=1e-9)
