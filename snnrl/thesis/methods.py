"""What single parts of the model do, measured on the model itself: windows, pulses, coincidences of two neurons.

Measurements step networks; figures of them are in `snnrl.thesis.figures`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch

from snnrl.body.world import World
from snnrl.configuration.builder import DTYPES, build, build_network
from snnrl.configuration.compose import compose
from snnrl.engines import Engine, make_engine
from snnrl.model.draws import Draws
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD, Config, GroupConfig, NetworkConfig, ProjectionConfig, SynapseConfig
from snnrl.simulation import Simulation

SURE = 200.0  # current of one ms that makes a neuron at rest fire at once
PAIR = 20  # ms within which a dopaminergic spike after a touch makes a coincidence: tau+
CHANCE = 3  # dopaminergic spikes in that time at most: background firing, not an answer to the touch


def environments() -> dict[str, World]:
    """The three worlds (thesis 3.1) at the start of trial 0, by what each adds."""
    added = {
        "food": "food_attraction",
        "food containers": "secondary_behaviour",
        "and empty ones": "secondary_stimulus",
    }
    return {
        name: build(compose(f"+experiment={experiment}", "trials=1")).situation.world
        for name, experiment in added.items()
    }


@dataclass(frozen=True)
class Window:
    """STDP on one synapse.

    Attributes:
        times: t_post - t_pre (ms), [n]. change: of eligibility by one pair of spikes, [n].
        gap: ms from the presynaptic to the postsynaptic spike of the pair after which `eligibility` is, by ms, [T].
    """

    times: np.ndarray
    change: np.ndarray
    gap: int
    eligibility: np.ndarray


def window(start: int = 30, gap: int = 2, end: int = 1500) -> Window:
    """That of food attraction; the pair's presynaptic spike is at `start`, and it is followed up to `end` (ms)."""
    config = compose("+experiment=food_attraction", "trials=1")
    after = pair_eligibility(config, np.array([start]), np.array([start + gap]), end)
    return Window(*stdp_window(config), gap, after)


def stdp_window(config: Config, reach: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Change of eligibility by t_post - t_pre (ms), both [2 reach + 1]: of one synapse, one pair of spikes each."""
    times = np.arange(-reach, reach + 1)
    seen = pair_eligibility(config, np.maximum(-times, 0), np.maximum(times, 0), reach + 1)
    return times, seen[np.abs(times), np.arange(len(times))]  # in the ms of the later spike


def pair_eligibility(config: Config, pre: np.ndarray, post: np.ndarray, end: int) -> np.ndarray:
    """Eligibility, [end, B] by ms, of B synapses alone, whose neurons fire once each, at `pre` and `post` [B] ms.

    The neurons, the rule and the dopamine are those of `config`; every ms is a step of the network.
    """
    trials = torch.arange(len(pre))
    network = build_network(_one_synapse(config.network), Draws(config.seed, trials), DTYPES[config.dtype])
    current = network.pending.new_zeros(end, network.trials, network.size)
    for neuron, times in enumerate((pre, post)):
        current[torch.from_numpy(times), trials, neuron] = SURE
    seen, raster = [], torch.zeros(end, network.trials, network.size, dtype=torch.bool)
    for k in range(end):
        network.run(current[k : k + 1], None, raster[k : k + 1])
        seen.append(network.projections["synapse"].eligibility.numpy().copy())
    assert (raster == (current > 0)).all(), "a pair of neurons did not fire once each"
    return np.array(seen)


def _one_synapse(network: NetworkConfig) -> NetworkConfig:
    """A plastic synapse of the network between two of its neurons, none that bursts; it does not excite."""
    neuron, parameters = next(iter(network.neurons.items()))
    assert network.dopamine is not None
    return dataclasses.replace(
        network,
        neurons={neuron: dataclasses.replace(parameters, c_spread=0.0, d_spread=0.0)},
        synapses={"plastic": SynapseConfig(probability=1.0, plastic=True)},
        groups={name: GroupConfig(1, neuron) for name in ("pre", "post")},
        projections={"synapse": ProjectionConfig("pre", "post", "plastic")},
        synaptic_gain=0.0,
        dopamine=dataclasses.replace(network.dopamine, source=None),
        homeostasis=None,
    )


def encoding() -> tuple[np.ndarray, np.ndarray]:
    """What `sensor_encoding` gives for a robot that only explores."""
    return sensor_encoding(compose("+experiment=food_attraction", "robot=random_walk", "trials=1"))


def sensor_encoding(config: Config, seconds: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Value of the left food sensor, raised from 0 to 1, by ms [T], and its neurons' spikes [T, n]."""
    simulation = build(config)
    network, coding = simulation.network, simulation.situation.coding
    ticks = ticks_of(seconds, coding.tick)
    group = coding.config.ranges["food"].left
    untouched = {name: torch.zeros(network.trials, dtype=torch.bool) for name in coding.config.touches}
    raster = torch.zeros(ticks * coding.tick, network.trials, network.size, dtype=torch.bool)
    for k in range(ticks):
        value = torch.tensor([[k / (ticks - 1), 0.0]], dtype=torch.float64).expand(network.trials, 2)
        current = coding.encode(network, {"food": value}, untouched)
        network.run(current, None, raster[k * coding.tick : (k + 1) * coding.tick])
    values = np.repeat(np.linspace(0, 1, ticks), coding.tick)
    return values, raster[:, 0, network.groups[group].span].numpy()


@dataclass(frozen=True)
class Coincidence:
    """One synapse from a touch neuron to a dopaminergic one, ms by ms.

    Attributes:
        start: ms at which the arrays begin.
        pre, post: whether the two neurons fired. eligibility, weight (mV), dopamine (uM): after each ms.
        at: row of the touch.
        food: rows at which the robot took an item.
    """

    start: int
    pre: np.ndarray
    post: np.ndarray
    eligibility: np.ndarray
    weight: np.ndarray
    dopamine: np.ndarray
    at: int
    food: np.ndarray


def chance(robot: str, touch: str, rewarded: bool) -> Coincidence | None:
    """The first chance coincidence in the first trial of a robot of secondary_stimulus; see `coincidence`."""
    config = compose("+experiment=secondary_stimulus", f"robot={robot}", "trials=1", "seconds=300")
    with torch.no_grad():
        return coincidence(config, make_engine("auto", config.device), touch, rewarded, 500, 2000)


def coincidence(
    config: Config, engine: Engine, touch: str, rewarded: bool, before: int, after: int
) -> Coincidence | None:
    """The first touch neuron that a dopaminergic neuron follows by chance within PAIR ms; None if there is none.

    Args:
        config: of one trial.
        touch: a touch sensor, as in `coding.touches`.
        rewarded: whether food must follow within `after` ms.
        before, after: how much to record round the touch, ms.
    """
    found = _find(build(config), engine, config, touch, rewarded, after)
    if found is None:
        return None
    time, pre, post = found
    simulation = build(config)
    network, tick = simulation.network, simulation.tick
    assert network.dopamine is not None
    projection = network.projections[f"{config.body()[0].touches[touch]}_to_{network.dopamine.sources['count']}"]
    [synapse] = ((projection.pre_index == pre) & (projection.post_index == post)).nonzero()[0].tolist()
    ends = network.groups[projection.pre].start + pre, network.groups[projection.post].start + post
    first = max(0, time // tick - before // tick)
    if first:
        simulation.run(engine, first)
    columns: dict[str, list[float]] = {key: [] for key in ("pre", "post", "eligibility", "weight", "dopamine")}
    food = []
    for k in range((before + after) // tick):
        taken = int(simulation.situation.world.count(FOOD)[0])
        current, sign, _ = simulation.situation.begin(network)
        if int(simulation.situation.world.count(FOOD)[0]) > taken:
            food.append(k * tick)
        raster = torch.zeros(1, 1, network.size, dtype=torch.bool)
        for ms in range(tick):
            engine.run_network(network, current[ms : ms + 1], sign, raster)
            columns["pre"].append(float(raster[0, 0, ends[0]]))
            columns["post"].append(float(raster[0, 0, ends[1]]))
            columns["eligibility"].append(float(projection.eligibility[synapse]))
            columns["weight"].append(float(projection.weight[synapse]))
            columns["dopamine"].append(float(network.dopamine.level[0]))
    arrays = {key: np.array(values) for key, values in columns.items()}
    return Coincidence(first * tick, at=time - first * tick, food=np.array(food), **arrays)


def _find(
    simulation: Simulation, engine: Engine, config: Config, touch: str, rewarded: bool, after: int
) -> tuple[int, int, int] | None:
    """Time (ms) of the touch spike, and the two neurons' numbers within their groups."""
    network, tick = simulation.network, simulation.tick
    assert network.dopamine is not None
    group = config.body()[0].touches[touch]
    projection = network.projections[f"{group}_to_{network.dopamine.sources['count']}"]
    joined = torch.zeros(projection.shape[1:], dtype=torch.bool)
    joined[projection.pre_index, projection.post_index] = True
    raster = torch.zeros(tick, 1, network.size, dtype=torch.bool)
    candidate: tuple[int, int, int] | None = None
    for _ in range(ticks_of(config.seconds, tick)):
        start, food = int(network.time), int(simulation.situation.world.count(FOOD)[0])
        simulation.run(engine, 1, raster)
        if candidate and start - candidate[0] > after:
            candidate = None
        if candidate and int(simulation.situation.world.count(FOOD)[0]) > food:
            return candidate
        touched = raster[:, 0, network.groups[group].span]
        if candidate or not touched.any():
            continue
        row = int(touched.any(1).nonzero()[0, 0])
        later = raster[row + 1 : row + 1 + PAIR, 0, network.groups[projection.post].span]
        pairs = (touched[row][:, None] & later.any(0) & joined).nonzero()
        if len(pairs) and int(later.sum()) <= CHANCE:
            candidate = (start + row, *pairs[0].tolist())
            if not rewarded:
                return candidate
    return None
