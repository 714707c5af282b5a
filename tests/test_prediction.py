"""The parts that predict reward: time cells, release around a tonic rate, pairs that count later, absence."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import ENGINES, compose_config, forced, group_of, run, silence
from torch import Tensor

from snnrl import Draws, build_network
from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.model.modulators import deviation
from snnrl.model.network import Network
from snnrl.model.plasticity import potentiate_later, window
from snnrl.schema import GroupConfig, ModulatorConfig, NetworkConfig, NeuronConfig, PlasticityConfig

FIELD = {"threshold": 5.0, "onset": 7.0, "width": 10.0, "period": 4.0}


def cells(**groups: GroupConfig) -> NetworkConfig:
    neuron = NeuronConfig(model="time_cell", v=-65.0, parameters=FIELD, spreads={"onset": 100.0})
    return NetworkConfig(
        neurons={"time_cell": neuron},
        groups=groups or {"memory": GroupConfig(3, "time_cell")},
        synaptic_gain=1.0,
        plasticity=PlasticityConfig(0.1, 0.15, 20.0, 110.0, 476.0, 4.0),
    )


def onsets(network: Network) -> Tensor:
    onset = group_of(network, "memory").onset
    assert isinstance(onset, Tensor)
    return onset


@pytest.mark.parametrize("engine", ENGINES)
def test_a_time_cell_fires_in_its_field_after_an_input_and_at_no_other_time(engine: str) -> None:
    network = build_network(cells(), Draws(0, torch.arange(2)), torch.float64)
    fired = run(engine, network, forced(network, 300, {("memory", 1): [20]}))
    onset = float(onsets(network)[0, 1])
    first = 20 + math.ceil(onset)
    times = fired[:, 0, 1].nonzero()[:, 0].tolist()
    assert times[0] == first
    assert times == [20 + math.ceil(onset + 4 * k) for k in range(3) if math.ceil(onset + 4 * k) < onset + 10]
    assert int(fired.sum()) == len(times)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_later_input_opens_the_field_anew(engine: str) -> None:
    network = build_network(cells(), Draws(0, torch.arange(1)), torch.float64)
    onset = math.ceil(float(onsets(network)[0, 0]))
    again = 20 + onset + 2  # in the field, between two spikes
    times = run(engine, network, forced(network, 400, {("memory", 0): [20, again]}))[:, 0, 0].nonzero()[:, 0]
    assert times[:2].tolist() == [20 + onset, again + onset]


@pytest.mark.parametrize("engine", ENGINES)
def test_silence_of_tonic_neurons_brings_dopamine_below_its_baseline(engine: str) -> None:
    config = cells(memory=GroupConfig(4, "time_cell"))
    config.dopamine = ModulatorConfig(
        baseline=-0.001, tau=20.0, delay=5, released="deviation", source="memory",
        values={"release": 0.01, "tonic": 0.5},
    )  # fmt: skip
    network = build_network(config, Draws(0, torch.arange(2)), torch.float64)
    run(engine, network, silence(network, 1000))
    assert network.dopamine is not None
    lowest = -0.001 - 0.01 * 0.5 / (1.0 - math.exp(-1.0 / 20.0))
    torch.testing.assert_close(network.dopamine.level, torch.full((2,), lowest, dtype=torch.float64))


def test_what_is_released_is_the_difference_from_the_tonic_spikes() -> None:
    count = torch.tensor([0.0, 2.0, 5.0])
    assert deviation(count, 0.5, 2.0).tolist() == [-1.0, 0.0, 1.5]


def test_a_pair_counts_most_at_its_time_constant_and_nothing_at_once() -> None:
    gains = window(potentiate_later, (0.1, 400.0))
    assert float(gains[0]) == 0.0
    assert int(gains.argmax()) == 400
    assert float(gains[400]) == pytest.approx(0.1)
    assert float(gains[2]) == pytest.approx(0.1 * 2 / 400 * math.exp(1 - 2 / 400))


@pytest.mark.parametrize("engine", ENGINES)
def test_food_that_is_absent_is_neither_taken_nor_sensed(engine: str) -> None:
    seconds = ("world.kinds.food.absent_from=2.1", "world.kinds.food.absent_until=4.2", "world.kinds.food.count=200")
    simulation = build(compose_config("+experiment=food_attraction", *seconds, "trials=2", "dtype=float64"))
    machine, world, network = make_engine(engine, "cpu", 1), simulation.situation.world, simulation.network
    groups = [list(network.groups).index(name) for name in ("left_food", "right_food")]
    taken, sensed = [], []
    for _ in range(3):
        before = world.count("food").clone(), network.spike_count[:, groups].clone()
        simulation.run(machine, 30)
        taken.append(int((world.count("food") - before[0]).min()))
        sensed.append(int((network.spike_count[:, groups] - before[1]).sum()))
    assert min(taken[0], taken[2]) > 0 == taken[1]
    assert min(sensed[0], sensed[2]) > 0 == sensed[1]


@pytest.mark.parametrize(
    "overrides",
    [
        ("world.kinds.food.absent_until=3",),
        ("world.kinds.food.absent_from=3", "world.kinds.food.absent_until=3"),
        ("world.kinds.food_container.absent_from=3",),
    ],
)
def test_an_absence_that_cannot_be_is_refused(overrides: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError, match="absent"):
        build(compose_config("+experiment=food_attraction", *overrides))
