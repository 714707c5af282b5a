"""The fused engine against the reference, and a trial against itself in other company."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from helpers import compose_config
from scipy import stats
from torch import Tensor

from snnrl.body.world import World
from snnrl.configuration.builder import build, build_network
from snnrl.engines import ReferenceEngine, make_engine
from snnrl.engines.fused import FusedEngine
from snnrl.model.draws import Draws
from snnrl.model.network import Network
from snnrl.schema import (
    ConfigError,
    GroupConfig,
    HomeostasisConfig,
    ModulatorConfig,
    NetworkConfig,
    NeuronConfig,
    PlasticityConfig,
    ProjectionConfig,
    SynapseConfig,
)
from snnrl.simulation import Simulation

ROBOTS = {
    "food-only, learning": ["+experiment=food_attraction"],
    "food-only, strong weights": ["+experiment=food_attraction", "+robot.weights.food_attraction=4"],
    "food-container, strong weights": ["+experiment=dual_learning", "+robot.weights.container_attraction=3.9"],
    "food-container, dampened often": [
        "+experiment=dual_learning",
        "+robot.weights.container_attraction=3",
        "+robot.weights.food_attraction=3",
        "+robot.weights.food_avoidance=3",
        "network.homeostasis.limit=1.5",
    ],
    "food-container, other readings": [
        "+experiment=dual_learning",
        "network.groups.dopaminergic.noise=0.19",
        "network.groups.dopaminergic.gaussian=0.1",
        "network.groups.dopaminergic.kick=25",
        "network.groups.dopaminergic.kick_rate=0.35",
        "+robot.weights.container_attraction=3",
        "network.homeostasis.limit=1.5",
        "+network.homeostasis.per_set.container_taxis={count_absent: true, limit: 1.2}",
        "network.plasticity.simultaneous=depresses",
        "network.plasticity.potentiation_from=arrival",
        "network.synapses.anticipation.delay=3",
        "world.kinds.food_container.avoids=[robot,containers]",
        "world.kinds.food_container.contains=whole",
        "world.overlap=nearest",
    ],
    "food and poison, both sensors onto the same neurons": [
        "+experiment=avoidance",
        "coding.ranges.poison={left: left_food, right: right_food}",
    ],
    "food-only, strong exploration, held, gains of the mean": [
        "+experiment=food_attraction",
        "coding.gain_acts_on=mean",
        "coding.exploration_gain=1.45",
        "coding.exploration_drawn=each_tick",
    ],
    "predicting": ["+experiment=extinction", "world.kinds.food.absent_from=2", "world.kinds.food.absent_until=4"],
    "poison": ["+experiment=food_attraction", "+robot.weights.food_attraction=2", "world.kinds.food.poison_from=0"],
}


def state(module: torch.nn.Module) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in module.state_dict().items()}


def assert_close(actual: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    for key, value in expected.items():
        difference = (actual[key].double() - value.double()).abs()
        assert (difference <= 1e-9 * (1.0 + value.double().abs())).all(), (key, difference.max())


def simulation(*overrides: str) -> Simulation:
    return build(compose_config(*overrides))


@pytest.mark.parametrize("overrides", ROBOTS.values(), ids=ROBOTS)
def test_engines_agree_on_every_spike_of_a_closed_loop(overrides: list[str]) -> None:
    first = simulation(*overrides, "trials=3", "dtype=float64", "seed=5")
    second = copy.deepcopy(first)
    ticks, tick = 72, first.situation.coding.tick  # 5.04 s
    raster = torch.zeros(ticks * tick, 3, first.network.size, dtype=torch.bool)
    other = torch.ones_like(raster)
    first.run(make_engine("reference", "cpu"), ticks, raster)
    second.run(make_engine("fused", "cpu", 2), ticks, other)
    assert raster.sum() > 1000
    assert torch.equal(raster, other)
    assert_close(state(second), state(first))


def third_network(seed: int, trials: int, dtype: torch.dtype) -> Network:
    """Sizes that are not round, delays, a recurrent projection, two plastic ones into one group, a loop."""
    config = NetworkConfig(
        neurons={
            "regular": NeuronConfig(a=0.02, b=0.2, c=-65.0, d=8.0, c_spread=15.0, d_spread=-6.0, v=-65.0),
            "fast": NeuronConfig(a=0.1, b=0.2, c=-65.0, d=2.0, v=-70.0),
        },
        synapses={
            "plastic": SynapseConfig(probability=0.3, weight=0.5, spread=2.0, plastic=True, delay=3),
            "quick": SynapseConfig(probability=0.5, weight=1.0, plastic=True),
            "fixed": SynapseConfig(probability=0.2, weight=3.0, spread=1.0, delay=13),
            "inhibiting": SynapseConfig(probability=0.4, weight=-2.0, spread=1.0, delay=2),
        },
        groups={
            "first": GroupConfig(size=17, neuron="regular", current=3.0, noise=6.0),
            "second": GroupConfig(size=31, neuron="regular", noise=4.5),
            "third": GroupConfig(size=5, neuron="fast", current=1.0),
            "one": GroupConfig(size=1, neuron="regular"),
        },
        projections={
            "a": ProjectionConfig(pre="first", post="second", synapse="plastic", role="forward"),
            "b": ProjectionConfig(pre="second", post="second", synapse="quick", role="recurrent"),
            "c": ProjectionConfig(pre="first", post="third", synapse="fixed"),
            "d": ProjectionConfig(pre="third", post="first", synapse="inhibiting"),
            "e": ProjectionConfig(pre="second", post="one", synapse="quick", role="forward"),
            "f": ProjectionConfig(pre="one", post="first", synapse="fixed"),
        },
        synaptic_gain=1.7,
        plasticity=PlasticityConfig(0.1, 0.12, 20.0, 30.0, 300.0, 2.5),
        dopamine=ModulatorConfig("second", baseline=-0.002, tau=40.0, release=0.004, delay=3, threshold=1),
        homeostasis=HomeostasisConfig({"all": ["forward"], "loop": ["recurrent"]}, 0.62, 0.05, True),
    )
    return build_network(config, Draws(seed, torch.arange(4, 4 + trials)), dtype)


def test_engines_agree_on_a_third_network() -> None:
    first = third_network(3, 3, torch.float64)
    second = copy.deepcopy(first)
    steps = 5000
    generator = torch.Generator().manual_seed(1)
    injected = 4.0 * torch.rand(steps, 3, first.size, generator=generator, dtype=torch.float64)
    sign = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    raster = torch.zeros(steps, 3, first.size, dtype=torch.bool)
    other = torch.ones_like(raster)
    make_engine("reference", "cpu").run_network(first, injected, sign, raster)
    make_engine("fused", "cpu", 2).run_network(second, injected, sign, other)
    assert raster.sum() > 5000
    assert torch.equal(raster, other)
    assert_close(state(second), state(first))


@pytest.mark.parametrize("engine", ["reference", "fused"])
def test_a_raster_may_be_of_the_first_trials_only(engine: str) -> None:
    first = simulation("+experiment=food_attraction", "trials=3")
    second = copy.deepcopy(first)
    ticks, tick = 4, first.situation.coding.tick
    whole = torch.zeros(ticks * tick, 3, first.network.size, dtype=torch.bool)
    part = torch.zeros(ticks * tick, 1, first.network.size, dtype=torch.bool)
    first.run(make_engine(engine, "cpu", 2), ticks, whole)
    second.run(make_engine(engine, "cpu", 2), ticks, part)
    assert part.any()
    assert torch.equal(part, whole[:, :1])


def test_engines_agree_statistically_in_float32() -> None:
    food = {}
    for engine in ("reference", "fused"):
        run = simulation("+experiment=food_attraction", "+robot.weights.food_attraction=1.5", "trials=40", "seed=2")
        run.run(make_engine(engine, "cpu"), 90)
        food[engine] = run.situation.world.touches[:, 0].double()
    assert food["reference"].sum() > 100
    # the same trials, so also close pair by pair until rounding has grown
    assert stats.ttest_rel(food["reference"], food["fused"]).pvalue > 0.01 or torch.equal(*food.values())


@pytest.mark.parametrize("engine", ["reference", "fused"])
@pytest.mark.parametrize("experiment", ["food_attraction", "dual_learning"])
def test_a_trial_is_the_same_alone_in_a_batch_and_in_a_part(engine: str, experiment: str) -> None:
    options = [f"+experiment={experiment}", "seed=11", "+robot.weights.food_attraction=2"]
    ticks = 25 if engine == "reference" else 300
    runs = {
        "batch": simulation(*options, "trials=7"),
        "part": simulation(*options, "trials=3", "trial_start=2"),
        "alone": simulation(*options, "trials=1", "trial_start=4"),
    }
    for k, run in enumerate(runs.values()):
        run.run(make_engine(engine, "cpu", 1 + k % 2), ticks)
    places = {"batch": 4, "part": 2, "alone": 0}
    expected = trial_state(runs["batch"], places["batch"])
    for name in ("part", "alone"):
        for key, value in trial_state(runs[name], places[name]).items():
            assert torch.equal(value, expected[key]), (name, key)


def trial_state(run: Simulation, place: int) -> dict[str, Tensor]:
    """The whole state of one trial of a batch."""
    result = {}
    for name, projection in run.network.projections.items():
        mine = projection.trial == place
        result[f"{name}.weight"], result[f"{name}.eligibility"] = projection.weight[mine], projection.eligibility[mine]
        result[f"{name}.post"] = projection.post_index[mine]
    for key, value in run.state_dict().items():
        if value.dim() and "projections" not in key:
            result[key] = value[place]
    return result


@pytest.mark.parametrize("engine", ["reference", "fused"])
def test_splitting_a_run_at_ticks_changes_nothing(engine: str) -> None:
    first = simulation("+experiment=food_attraction", "+robot.weights.food_attraction=2", "trials=2")
    second = copy.deepcopy(first)
    chosen = make_engine(engine, "cpu")
    first.run(chosen, 30)
    for part in (1, 17, 12):
        second.run(chosen, part)
    for key, value in state(first).items():
        assert torch.equal(value, second.state_dict()[key]), key


@pytest.mark.parametrize("engine", ["reference", "fused"])
def test_state_dict_carries_the_whole_state(engine: str) -> None:
    """Saved in mid-flight, with spikes on their way and dopamine in its delay line, and loaded elsewhere."""
    first = simulation("+experiment=dual_learning", "+robot.weights.food_attraction=2", "trials=2", "dtype=float64")
    second = copy.deepcopy(first)
    chosen = make_engine(engine, "cpu")
    first.run(chosen, 20)
    second.load_state_dict(first.state_dict())
    first.run(chosen, 10)
    second.run(chosen, 10)
    for key, value in state(first).items():
        assert torch.equal(value, second.state_dict()[key]), key


def test_state_dict_carries_delay_lines() -> None:
    first = third_network(1, 2, torch.float64)
    second = third_network(1, 2, torch.float64)
    chosen = make_engine("fused", "cpu")
    driven = torch.full((257, 2, first.size), 9.0, dtype=torch.float64)
    chosen.run_network(first, driven)
    assert (first.pending != 0).any()
    second.load_state_dict(first.state_dict())
    for network in (first, second):
        chosen.run_network(network, torch.zeros(20, 2, first.size, dtype=torch.float64))
    assert torch.equal(first.neurons.v, second.neurons.v)
    assert torch.equal(first.synapses.weight, second.synapses.weight)


def test_modules_keep_sharing_memory_with_the_tables_after_copies_and_casts() -> None:
    run = copy.deepcopy(simulation("+experiment=food_attraction", "trials=2"))
    chosen = make_engine("fused", "cpu")
    run.run(chosen, 20)
    run.double().run(chosen, 20)
    network = run.network
    assert network.neurons.v.dtype == run.situation.world.position.dtype == torch.float64
    for group in network.groups.values():
        assert torch.equal(group.v, network.neurons.v[:, group.span])
    assert (network.groups["left_motor"].last_spike >= 0).any()
    joined = torch.cat([projection.weight for projection in network.projections.values()])
    assert torch.equal(joined, network.synapses.weight)
    assert (network.projections["left_food_to_right_motor"].eligibility != 0).any()


def test_world_stays_float64_whatever_the_networks_precision() -> None:
    run = simulation("+experiment=food_attraction", "trials=2", "dtype=float64").float()
    assert run.network.dtype == torch.float32
    assert run.situation.world.position.dtype == run.situation.world.places.dtype == torch.float64


def test_reference_tick_never_waits_for_the_host() -> None:
    """No value of a tensor is asked for inside a tick, so that it can be captured as a CUDA graph."""
    from torch._subclasses.fake_tensor import FakeTensorMode

    run = simulation("+experiment=dual_learning", "trials=2")
    with FakeTensorMode(allow_non_fake_inputs=True):
        run.situation.coding.tick = 3
        run.run(ReferenceEngine(), 1)


def test_fused_engine_refuses_other_devices() -> None:
    with pytest.raises(ConfigError, match="engine=fused: runs on device=cpu only"):
        make_engine("fused", "cuda")


def test_tensors_exchanged_between_two_runs_are_noticed() -> None:
    exchanged, same = (simulation("+experiment=food_attraction", "trials=2") for _ in range(2))
    fused = make_engine("fused", "cpu", 1)
    for one in (exchanged, same):
        one.run(fused, 3)
    network, world = exchanged.network, exchanged.situation.world
    network.spike_count = network.spike_count.clone()
    network.modulators["dopamine"].level = network.modulators["dopamine"].level.clone()
    world.position = world.position.clone()
    for one in (exchanged, same):
        one.run(fused, 20)
    for name, values in same.state_dict().items():
        assert torch.equal(exchanged.state_dict()[name], values), name


class Faster(World):
    pass


class Softer(Network):
    pass


def test_fused_engine_refuses_what_it_has_not_compiled() -> None:
    fused = make_engine("fused", "cpu", 1)
    with_world = simulation("+experiment=food_attraction", "trials=1")
    with_world.situation.world.__class__ = Faster
    with pytest.raises(ConfigError, match="engine=fused: cannot run Faster; use engine=reference"):
        with_world.run(fused, 1)
    network = simulation("+experiment=food_attraction", "trials=1").network
    injected = torch.zeros(3, 1, network.size)
    fused.run_network(network, injected)
    network.step = network.step  # type: ignore[method-assign]
    with pytest.raises(ConfigError, match=r"engine=fused: cannot run a changed Network\.step; use engine=reference"):
        fused.run_network(network, injected)
    del network.step
    fused.run_network(network, injected)
    network.__class__ = Softer
    with pytest.raises(ConfigError, match="engine=fused: cannot run Softer; use engine=reference"):
        fused.run_network(network, injected)
    assert network.time == 6
    make_engine("reference", "cpu").run_network(network, injected)


def test_auto_is_fused_on_the_cpu_and_the_reference_where_nothing_is_compiled() -> None:
    assert make_engine("auto", "cpu").name == "fused"
    assert make_engine("auto", "mps").name == "reference"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_tick_runs_as_a_cuda_graph() -> None:
    options = ["+experiment=food_attraction", "+robot.weights.food_attraction=2", "trials=3", "dtype=float64"]
    expected = simulation(*options)
    run = simulation(*options, "device=cuda")
    run.run(ReferenceEngine(), 1)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        run.run(ReferenceEngine(), 1)
    for _ in range(9):
        graph.replay()
    expected.run(make_engine("reference", "cpu"), 10)
    assert torch.equal(run.network.spike_count.cpu(), expected.network.spike_count)


def test_a_trial_needs_less_than_a_megabyte() -> None:
    """All state and topology of the larger robot, with what the fused engine keeps beside it."""
    run = simulation("+experiment=dual_learning", "trials=20")
    engine = FusedEngine(1)
    run.run(engine, 1)
    seen: dict[int, int] = {}
    tables = [*vars(run.network.neurons).values(), *vars(run.network.synapses).values()]
    for tensor in [*run.buffers(), *tables]:
        if isinstance(tensor, Tensor):
            seen[tensor.untyped_storage().data_ptr()] = tensor.untyped_storage().nbytes()
    [bound] = engine._bound.values()
    kept = sum(array.nbytes for array in (*bound.tables, bound.topology.settled) if isinstance(array, np.ndarray))
    assert sum(seen.values()) + kept < 20 * 1_000_000
