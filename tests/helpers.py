"""Small networks, worlds, whole simulations and finished runs for the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from snnrl.body.world import World
from snnrl.body.world.kinds import ENTERED, TAKEN
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose as compose_config
from snnrl.engines import make_engine
from snnrl.engines.fused.compiler import Program
from snnrl.model.draws import Draws
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.modulators import Modulator
from snnrl.model.network import Network
from snnrl.model.neurons import IZHIKEVICH, NeuronGroup
from snnrl.model.plasticity import Plasticity
from snnrl.model.synapses import Projection
from snnrl.recording.runs import Run
from snnrl.schema import KindConfig, SensorConfig, WorldConfig
from snnrl.simulation import Simulation

ENGINES = ("reference", "fused")

EXCITATORY = (0.02, 0.2, -65.0, 8.0)  # a, b, c, d
INHIBITORY = (0.1, 0.2, -65.0, 8.0)
RULE = Plasticity(0.1, 0.15, 20.0, 110.0, 476.0, 4.0)
SMALL_TASK = (  # a tenth of the network
    "network.groups.excitatory.size=80",
    "network.groups.inhibitory.size=20",
    "network.synapses.to_excitatory.fan_out=40",
    "network.synapses.to_inhibitory.fan_out=10",
    "network.synapses.inhibition.fan_out=50",
)
SMALL_STIMULI = ("task.stimuli.count=5", "task.stimuli.size=30")
SURE = 200.0  # current that makes a neuron fire in the ms in which it gets it, gently


def compiled(function: Callable[..., Any], real: type = np.float64) -> Any:
    """A mechanism, or a kernel without placeholders, as the fused engine compiles it."""
    return Program(real, {}).kernel(function)


def make_group(
    name: str,
    size: int,
    trials: int = 1,
    parameters: Sequence[float] = EXCITATORY,
    current: float = 0.0,
    noise: float = 0.0,
    dtype: torch.dtype = torch.float64,
    **background: float,
) -> NeuronGroup:
    values = {
        key: torch.full((trials, size), value, dtype=dtype) for key, value in zip("abcd", parameters, strict=True)
    }
    return NeuronGroup(name, IZHIKEVICH, values, -65.0, current, noise, **background)


def make_projection(
    name: str,
    pre: str,
    post: str,
    weight: Tensor,
    plastic: bool = True,
    delay: int = 1,
    rule: Plasticity = RULE,
) -> Projection:
    """A projection with the weights [B, n_pre, n_post]; pairs whose weight is nan are not joined."""
    return Projection(name, pre, post, ~weight.isnan(), weight, rule if plastic else None, delay)


def make_dopamine(trials: int = 1, dtype: torch.dtype = torch.float64, **changed: Any) -> Modulator:
    """Dopamine from the group `dopaminergic` with the thesis's numbers, unless changed."""
    given: dict[str, Any] = {"baseline": -0.0004, "tau": 25.0, "release": 0.0035, "delay": 5, "threshold": 5, **changed}
    values = {key: float(given.pop(key)) for key in ("release", "threshold")}
    sources = given.pop("sources", {"count": "dopaminergic"})
    return Modulator("dopamine", sources, trials, values=values, dtype=dtype, device="cpu", **given)


def make_network(
    groups: Sequence[NeuronGroup],
    projections: Sequence[Projection] = (),
    dopamine: Modulator | None = None,
    homeostasis: Mapping[str, Homeostasis] | None = None,
    gain: float = 1.0,
    seed: int = 0,
) -> Network:
    draws = Draws(seed, torch.arange(len(groups[0].v)))
    return Network(groups, projections, draws, gain, [] if dopamine is None else [dopamine], homeostasis)


def group_of(network: Network, name: str) -> NeuronGroup:
    group = network.groups[name]
    assert isinstance(group, NeuronGroup)
    return group


def projections_of(network: Network) -> list[Projection]:
    """In the order in which the network keeps them."""
    return [projection for projection in network.projections.values() if isinstance(projection, Projection)]


def ends_of(projection: Projection) -> list[tuple[int, int, int]]:
    """Trial, presynaptic and postsynaptic neuron of every synapse."""
    ends = torch.stack([projection.trial, projection.pre_index, projection.post_index], 1)
    return [(trial, pre, post) for trial, pre, post in ends.tolist()]


def silence(network: Network, steps: int) -> Tensor:
    """No injected current, [steps, B, N]."""
    return torch.zeros(steps, network.trials, network.size, dtype=network.dtype)


def forced(network: Network, steps: int, spikes: Mapping[tuple[str, int], Sequence[int]], trial: int = 0) -> Tensor:
    """Injected current [steps, B, N] that makes neuron (group, index) fire at the given times (ms)."""
    injected = silence(network, steps)
    for (group, index), times in spikes.items():
        injected[list(times), trial, group_of(network, group).start + index] = SURE
    return injected


def run(engine: str, network: Network, injected: Tensor, sign: Tensor | None = None) -> Tensor:
    """Who fired, bool [T, B, N]."""
    raster = torch.zeros(injected.shape, dtype=torch.bool)
    make_engine(engine, "cpu", 1).run_network(network, injected, sign, raster)
    return raster


def run_each(engine: str, network: Network, injected: Tensor, *watched: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Run ms by ms; who fired, and the watched tensors after every ms, [T, ...] each."""
    machine = make_engine(engine, "cpu", 1)
    raster = torch.zeros(injected.shape, dtype=torch.bool)
    seen: list[list[Tensor]] = [[] for _ in watched]
    for k in range(len(injected)):
        machine.run_network(network, injected[k : k + 1], None, raster[k : k + 1])
        for values, tensor in zip(seen, watched, strict=True):
            values.append(tensor.clone())
    return raster, [torch.stack(values) for values in seen]


def spikes_of(raster: Tensor, neuron: int, trial: int = 0) -> list[int]:
    """Spike times (ms) of one neuron of a raster [T, B, N]."""
    return raster[:, trial, neuron].nonzero()[:, 0].tolist()


def make_world(
    trials: int = 1,
    free_items: int = 0,
    food_containers: int = 0,
    empty_containers: int = 0,
    side: float = 300.0,
    to_border: bool = True,
    poison_from: float | None = None,
    overlap: str = "stays",
    attempts: int = 1,
    avoids: Sequence[str] = (),
    contains: str = "centre",
    **more: KindConfig,
) -> World:
    """A world with the thesis's sizes, a tick of 70 ms and both range sensors, and kinds of objects besides.

    `avoids` and `contains` are the food containers'.
    """
    measured = "border" if to_border else "centre"
    kinds = {
        "food": KindConfig(free_items, 2.4, poison_from=poison_from),
        "food_container": KindConfig(
            food_containers, 14.0, "entered", "food", speed=0.5, avoids=list(avoids), contains=contains
        ),
        "empty_container": KindConfig(empty_containers, 14.0, "entered", speed=0.5),
        **more,
    }
    ranges = {
        "food": SensorConfig(30.0, measured),
        "container": SensorConfig(60.0, measured, ["food_container", "empty_container"]),
    }
    config = WorldConfig(side, 1.0, kinds, ranges, overlap, attempts)
    return World(Draws(0, torch.arange(trials)), config, 70)


def items(world: World) -> Tensor:
    """Where what can be taken is, [B, n, 2]: what lies free first."""
    return world.places[:, world.kinds.effect[world.kinds.kind] == TAKEN]


def containers(world: World) -> Tensor:
    """Where what can be entered is, [B, n, 2]."""
    return world.places[:, world.kinds.effect[world.kinds.kind] == ENTERED]


def place(
    world: World,
    position: Sequence[float],
    heading: float = 0.0,
    items: Sequence[Sequence[float]] = (),
    containers: Sequence[Sequence[float]] = (),
    inside: int = -1,
    trial: int = 0,
) -> None:
    """Put one trial's robot, items and containers where they are wanted; `inside` counts the containers."""
    effect = world.kinds.effect[world.kinds.kind]
    world.position[trial] = torch.tensor(position, dtype=torch.float64)
    world.heading[trial] = heading
    for kind, places in ((TAKEN, items), (ENTERED, containers)):
        world.places[trial, effect == kind] = torch.tensor(places, dtype=torch.float64).view(-1, 2)
    world.inside[trial] = int((effect == ENTERED).nonzero()[inside, 0]) if inside >= 0 else -1


def hand_made(**parts: Any) -> Run:
    """A finished run whose parts are given instead of read from files."""
    run = Run(Path("nowhere"))
    run.__dict__.update(parts)
    return run


def with_weights(time: np.ndarray, **of_projections: np.ndarray) -> Run:
    """A finished run of which the mean weights [T, B] of some projections are known."""
    weight = np.stack(list(of_projections.values()), 2)
    return hand_made(series={"time": time, "weight": weight, "projections": np.array(list(of_projections))})


def make_simulation(*overrides: str) -> Simulation:
    """A whole simulation in float64 on one thread."""
    return build(compose_config(*overrides, "dtype=float64", "threads=1"))


def called(module: str, folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """What `python -m MODULE WORDS` has done in a folder."""
    return subprocess.run(
        [sys.executable, "-m", module, *words],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
