"""Rhythm, winners and exploration inside the network: what is measured, by hand, and that each mechanism works."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
import torch
from helpers import compose_config
from labels import faults

from snnrl.beyond import in_network
from snnrl.beyond.in_network import MOTORS, RHYTHM, ROBOTS, SENSORS, TASKS, Life, live, make, peak, watch
from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.simulation import Simulation

SMALL = ("trials=2", "seed=3000000", "threads=1")
SEEING = ("world.side=65", "world.kinds.food.count=60")  # food on both sides at nearly all times
TAUGHT = ("+robot.weights.food_attraction=2", "robot.learning=false")


def made(robot: str, *overrides: str, experiment: str = "in_network") -> Simulation:
    return build(compose_config(f"+experiment={experiment}", f"robot={robot}", *SMALL, *overrides))


def watched(simulation: Simulation, seconds: float) -> Life:
    ticks = round(1000 * seconds / simulation.tick)
    spikes = watch(simulation, make_engine("auto", "cpu", 1), ticks)
    return life_of(spikes, simulation.tick, simulation.trials)


def life_of(spikes: Mapping[str, np.ndarray], tick: int, trials: int) -> Life:
    return Life("", "", np.zeros(0), np.zeros((0, trials)), np.zeros(trials, bool), tick, dict(spikes), True)


def test_a_winner_has_nine_of_ten_spikes_of_a_tick_in_which_there_are_any() -> None:
    left, right = np.zeros((12, 1), np.int64), np.zeros((12, 1), np.int64)  # six ticks of 2 ms
    left[[0, 1, 4, 6], 0] = 5, 4, 1, 8
    right[[1, 4, 7, 9], 0] = 1, 1, 1, 3
    found = life_of(dict(zip(MOTORS, (left, right), strict=True)), 2, 1)
    assert found.won(MOTORS) == pytest.approx(2 / 4)  # 9 : 1, 1 : 1, 8 : 1, 0 : 3
    assert np.isnan(life_of(dict.fromkeys(MOTORS, 0 * left), 2, 1).won(MOTORS))


@pytest.mark.parametrize(("hertz", "near"), [(14.0, 1.0), (40.0, 0.0)])
def test_the_peak_of_a_sine_is_its_frequency(hertz: float, near: float) -> None:
    wave = 1.0 + np.sin(2 * np.pi * hertz * np.arange(8000) / 1000.0)
    frequency, share = peak(np.stack([wave, wave], 1))
    assert frequency == pytest.approx(hertz, abs=0.25)  # half of a segment's resolution
    assert share == pytest.approx(near, abs=1e-3)


def test_the_rhythm_has_one_cycle_a_tick_or_nearly_by_the_inhibition_among_its_neurons() -> None:
    for seed in (3, 4):
        hertz, share = peak(watched(made("phasic", f"seed={seed}"), 10.0).spikes[RHYTHM])
        assert 10.0 < hertz < 20.0
        assert share > 0.6
    loose = watched(made("phasic", "network.synapses.pacing.weight=0"), 10.0).spikes[RHYTHM]
    assert peak(loose)[1] < 0.5 * share


def test_the_rhythm_makes_sensors_of_constant_current_fire_in_its_time() -> None:
    with_it, without = (watched(made(robot, *SEEING), 20.0) for robot in ("phasic", "no_rhythm"))
    shares = [peak(found.spikes[SENSORS[0]] + found.spikes[SENSORS[1]])[1] for found in (with_it, without)]
    assert shares[0] > 1.1 * shares[1]


@pytest.mark.parametrize("pair", [MOTORS, SENSORS])
def test_one_of_two_rivals_wins_more_often_because_they_inhibit_each_other(pair: tuple[str, str]) -> None:
    with_it, without = (watched(made(robot, *SEEING, *TAUGHT), 20.0).won(pair) for robot in ("winner", "no_rivalry"))
    assert with_it > 1.15 * without
    assert without > 0.0


def test_background_firing_alone_moves_the_robot_to_both_sides() -> None:
    simulation = made("background", "robot.learning=false", "world.kinds.food.count=0")
    found = watched(simulation, 20.0)
    left, right = (found.spikes[name].reshape(-1, 70, 2).sum(1) for name in MOTORS)
    for side in (left > right, right > left):
        assert ((side.mean(0) > 0.3) & (side.mean(0) < 0.7)).all()


def test_a_robot_without_any_of_it_is_the_thesis_robot() -> None:
    """More neurons that nothing drives change nothing."""
    plain = build(compose_config("+experiment=food_attraction", *SMALL))
    inside = made("learning")
    for simulation in (plain, inside):
        simulation.run(make_engine("fused", "cpu", 1), 400)
    assert torch.equal(inside.situation.world.position, plain.situation.world.position)
    for name, projection in plain.network.projections.items():
        assert torch.equal(inside.network.projections[name].weight, projection.weight), name
    assert (plain.situation.world.count("food") > 0).all()


def test_engines_agree_on_every_spike_of_all_of_it() -> None:
    rasters = []
    for engine in ("reference", "fused"):
        simulation = made("in_network", "dtype=float64", "world.side=149", experiment="in_network_dual")
        raster = torch.zeros(20 * 70, 2, simulation.network.size, dtype=torch.bool)
        simulation.run(make_engine(engine, "cpu", 1), 20, raster)
        rasters.append(raster)
    assert torch.equal(*rasters)
    assert int(rasters[0].sum()) > 1000


def test_food_is_counted_in_the_span_in_which_it_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_network, "SPANS", 3)
    monkeypatch.setattr(in_network, "WATCHED", 0.07)
    found = live("food attraction", "learning", (*SMALL, *SEEING, "seconds=21"))
    assert found.time.tolist() == pytest.approx([7.0, 14.0, 21.0])
    simulation = made("learning", *SEEING)
    simulation.run(make_engine("auto", "cpu", 1), 100)
    assert (7.0 * found.food[0]).tolist() == pytest.approx(simulation.situation.world.count("food").tolist())
    assert (found.food > 0).all()


def test_every_robot_of_every_task_is_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_network, "SPANS", 2)
    monkeypatch.setattr(in_network, "WATCHED", 3.0)
    page = make((*SMALL, "seconds=4"), 0.5)
    assert not faults(page.figure)
    rows = page.table.splitlines()[2:]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    assert [(task, robot.replace(" ", "_")) for task, robot, *_ in cells] == [(t, r) for t in TASKS for r in ROBOTS]
    assert all((cell[4] != "") == (cell[1] in ("phasic", "in network")) for cell in cells)
