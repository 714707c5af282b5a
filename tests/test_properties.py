"""What must hold whatever the numbers are."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import torch
from helpers import (
    ENGINES,
    RULE,
    forced,
    make_dopamine,
    make_group,
    make_network,
    make_projection,
    make_simulation,
    make_world,
    place,
    run,
    run_each,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from snnrl.engines import make_engine
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.network import Network
from snnrl.model.plasticity import Plasticity

engines = st.sampled_from(ENGINES)
seeds = st.integers(0, 2**32 - 1)
repeatable = settings(derandomize=True, deadline=None, max_examples=15)


def small_network(
    seed: int, trials: int = 1, plastic: bool = True, levels: dict[str, float] | None = None, **rule: float
) -> tuple[Network, Tensor]:
    """Two groups of odd sizes that excite each other at random and are driven hard, for 250 ms."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    def weights(pre: int, post: int) -> Tensor:
        weight = 4.0 * uniform(trials, pre, post)
        return torch.where(uniform(trials, pre, post) < 0.6, weight, torch.nan)

    learns = replace(RULE, **rule)  # type: ignore[arg-type]
    changed: dict[str, Any] = {"threshold": 1, "release": 0.05, **(levels or {})}
    dopamine = make_dopamine(trials, **changed)
    network = make_network(
        [make_group("first", 7, trials), make_group("dopaminergic", 9, trials)],
        [
            make_projection("a", "first", "dopaminergic", weights(7, 9), plastic, delay=3, rule=learns),
            make_projection("b", "dopaminergic", "first", weights(9, 7), plastic, rule=learns),
            make_projection("c", "dopaminergic", "dopaminergic", weights(9, 9), False, delay=2),
        ],
        dopamine,
        {"all": Homeostasis(("a", "b"), 1.3, 0.05, True)} if plastic else None,
    )
    return network, 40.0 * uniform(250, trials, 16) ** 2


amounts = st.floats(0.0, 50.0)
taus = st.floats(0.1, 3000.0)


@repeatable
@given(engines, seeds, amounts, amounts, taus, taus, taus, st.floats(-5.0, 5.0), taus, st.floats(-2.0, 2.0))
def test_weights_never_leave_their_bounds(
    engine: str,
    seed: int,
    potentiation: float,
    depression: float,
    tau_plus: float,
    tau_minus: float,
    tau_eligibility: float,
    baseline: float,
    tau: float,
    release: float,
) -> None:
    rule = {"tau_plus": tau_plus, "tau_minus": tau_minus, "tau_eligibility": tau_eligibility}
    levels = {"baseline": baseline, "tau": tau, "release": release}
    network, injected = small_network(seed, 1, True, levels, potentiation=potentiation, depression=depression, **rule)
    _, (weights,) = run_each(engine, network, injected, network.synapses.weight)
    plastic = weights[:, : network.synapses.plastic]
    assert (plastic >= 0.0).all()
    assert (plastic <= 4.0).all()


@repeatable
@given(engines, seeds)
def test_without_plasticity_weights_stay_bit_for_bit(engine: str, seed: int) -> None:
    network, injected = small_network(seed, plastic=False)
    before = network.synapses.weight.clone()
    assert run(engine, network, injected).any()
    assert torch.equal(network.synapses.weight, before)


@repeatable
@given(engines, seeds, st.lists(st.integers(1, 60), min_size=1, max_size=8))
def test_any_split_changes_nothing(engine: str, seed: int, parts: list[int]) -> None:
    """Bit for bit in the reference. The fused engine rounds anew where its blocks begin: same spikes, 1e-12."""
    whole, injected = small_network(seed)
    split = copy.deepcopy(whole)
    expected, actual, start = run(engine, whole, injected), [], 0
    for part in (*parts, len(injected)):
        actual.append(run(engine, split, injected[start : start + part]))
        start = min(start + part, len(injected))
        if start == len(injected):
            break
    assert torch.equal(torch.cat(actual), expected)
    within = 0.0 if engine == "reference" else 1e-12
    for key in ("weight", "eligibility"):
        values = getattr(split.synapses, key), getattr(whole.synapses, key)
        torch.testing.assert_close(*values, rtol=0, atol=within)


@repeatable
@given(engines, seeds, st.permutations(range(4)))
def test_permuting_trials_permutes_results(engine: str, seed: int, order: list[int]) -> None:
    network, injected = small_network(seed, 4)
    groups = [make_group("first", 7, 4), make_group("dopaminergic", 9, 4)]
    projections = [
        make_projection(name, p.pre, p.post, dense(p)[order], p.plastic, p.delay)
        for name, p in network.projections.items()
    ]
    permuted = make_network(
        groups, projections, make_dopamine(4, threshold=1, release=0.05), network.homeostasis, network.synaptic_gain
    )
    raster = run(engine, network, injected)
    assert torch.equal(run(engine, permuted, injected[:, order]), raster[:, order])
    for name, projection in network.projections.items():
        torch.testing.assert_close(
            dense(permuted.projections[name]), dense(projection)[order], rtol=0, atol=0, equal_nan=True
        )


def dense(projection: Any) -> Tensor:
    """Weights [B, n_pre, n_post], nan where there is no synapse."""
    weight = torch.full(projection.shape, torch.nan, dtype=projection.weight.dtype)
    weight[projection.trial, projection.pre_index, projection.post_index] = projection.weight
    return weight


@repeatable
@given(engines, seeds, st.permutations(range(7)), st.permutations(range(9)))
def test_a_relabelled_network_gives_relabelled_results(
    engine: str, seed: int, first: list[int], second: list[int]
) -> None:
    """Groups and projections in the other order, neurons permuted. Weights are multiples of 2^-20 and the gain is
    1, so that currents add up to the same in any order; without plasticity, spikes are then equal for good."""
    network, injected = small_network(seed, plastic=False)
    order = {"first": first, "dopaminergic": second}

    def exact(projection: Any) -> Tensor:
        return torch.round(dense(projection) * 2**20) / 2**20

    def rebuilt(relabelled: bool) -> Network:
        projections = [
            make_projection(
                name,
                p.pre,
                p.post,
                exact(p)[:, order[p.pre]][:, :, order[p.post]] if relabelled else exact(p),
                False,
                p.delay,
            )
            for name, p in network.projections.items()
        ]
        groups = [make_group("first", 7), make_group("dopaminergic", 9)]
        step = -1 if relabelled else 1
        return make_network(groups[::step], projections[::step], make_dopamine(threshold=1))

    injected = torch.round(injected * 2**20) / 2**20
    one, two = injected[..., :7], injected[..., 7:]
    plain, other = rebuilt(False), rebuilt(True)
    raster = run(engine, plain, injected)
    relabelled = run(engine, other, torch.cat([two[..., second], one[..., first]], -1))
    assert raster.any()
    assert torch.equal(relabelled[..., 9:], raster[..., :7][..., first])
    assert torch.equal(relabelled[..., :9], raster[..., 7:][..., second])
    assert plain.dopamine is not None
    assert other.dopamine is not None
    assert torch.equal(plain.dopamine.level, other.dopamine.level)


@repeatable
@given(st.integers(0, 2**20), st.integers(0, 2**20), st.integers(0, 16383), st.integers(0, 16383))
def test_shifting_a_world_on_the_torus_changes_nothing(robot: int, item: int, right: int, up: int) -> None:
    """Exact for a side of 256 cm, places and shifts in multiples of 1/64 cm, and a way along an axis."""
    sensed, paths = [], []
    for shift in ((0.0, 0.0), (right / 64, up / 64)):

        def shifted(x: int, y: int, by: tuple[float, float] = shift) -> tuple[float, float]:
            return (x / 64 + by[0]) % 256.0, (y / 64 + by[1]) % 256.0

        world = make_world(free_items=2, side=256.0)
        start = robot % 16384, robot // 64
        place(world, shifted(*start), 0.0, [shifted(item % 16384, item // 64), shifted(start[0] + 1280, start[1] + 64)])
        world.tick = 125  # ms, in which 40 cm/s make 5 cm
        wheels, origin = torch.full((1, 2), 40.0, dtype=torch.float64), world.position.clone()
        values, path, touched = [], [], False
        while not touched:  # a new item is put where the world's own numbers say
            touched = bool(world.step(wheels, torch.tensor(0))["food"].any())
            path.append(torch.remainder(world.position - origin, 256.0))
            values.append(torch.zeros(1, 2) if touched else world.sense()["food"])
        sensed.append(values)
        paths.append(path)
    assert len(sensed[0]) == len(sensed[1])
    for one, two in zip(sensed[0] + paths[0], sensed[1] + paths[1], strict=True):
        assert torch.equal(one, two)


@settings(derandomize=True, deadline=None, max_examples=4)
@given(engines, st.integers(0, 1000))
def test_a_mirrored_world_with_a_mirrored_brain_gives_a_mirrored_run(engine: str, seed: int) -> None:
    """The mirrored brain is the same one with its eyes and its wheels exchanged; new items are mirrored ones.
    Spikes are equal; places are mirrored to rounding."""
    options = ["trials=2", f"seed={seed}", "+robot.weights.food_attraction=3", "world.kinds.food.count=40"]
    run = make_simulation("+experiment=food_attraction", *options)
    mirrored, side = copy.deepcopy(run), run.situation.world.config.side

    def mirror() -> list[Tensor]:
        flip = torch.tensor([1.0, -1.0], dtype=torch.float64)
        places = [
            torch.remainder(flip * value, side) for value in (run.situation.world.position, run.situation.world.places)
        ]
        return [*places, torch.remainder(-run.situation.world.heading, 2.0 * math.pi)]

    world = mirrored.situation.world
    for target, source in zip((world.position, world.places, world.heading), mirror(), strict=True):
        target.copy_(source)
    machine = make_engine(engine, "cpu", 1)
    for _ in range(40):
        for simulation, turn in ((run, lambda pair: pair), (mirrored, lambda pair: pair.flip(1))):
            network = simulation.network
            touched = simulation.situation.world.step(turn(simulation.situation.coding.decode(network)), network.time)
            if simulation is mirrored:
                world.places.copy_(mirror()[1])
            values = {name: turn(value) for name, value in simulation.situation.world.sense().items()}
            machine.run_network(network, simulation.situation.coding.encode(network, values, touched))
    assert run.situation.world.touches.sum() > 0
    assert torch.equal(world.touches, run.situation.world.touches)
    assert torch.equal(mirrored.network.spike_count, run.network.spike_count)
    position, _, heading = mirror()
    for actual, expected, period in ((world.position, position, side), (world.heading, heading, 2.0 * math.pi)):
        off = torch.remainder(actual - expected + 0.5 * period, period) - 0.5 * period
        assert off.abs().max() < 1e-9


@repeatable
@given(engines, st.integers(1, 60), st.integers(1, 60), st.floats(5.0, 200.0), st.floats(5.0, 600.0))
def test_time_is_counted_in_steps(engine: str, first: int, gap: int, tau: float, tau_eligibility: float) -> None:
    """Half the step is the same network with all times doubled: what takes n steps then takes 2 n, and an
    exponential is the same at the doubled time. So eligibility and dopamine agree where the spikes do."""
    results = []
    for scale in (1, 2):
        steps = scale * (first + gap + 80)
        rule = Plasticity(0.1, 0.15, scale * 20.0, scale * 110.0, scale * tau_eligibility, 4.0)
        network = make_network(
            [make_group("pre", 1), make_group("post", 1), make_group("dopaminergic", 1)],
            [make_projection("a", "pre", "post", torch.full((1, 1, 1), 2.0, dtype=torch.float64), rule=rule)],
            make_dopamine(baseline=0.0, tau=scale * tau, delay=scale * 5, threshold=0),
            gain=0.0,
        )
        times = {
            ("pre", 0): [scale * first],
            ("post", 0): [scale * (first + gap)],
            ("dopaminergic", 0): [scale * first],
        }
        assert network.dopamine is not None
        watched = network.synapses.eligibility, network.dopamine.level
        raster, seen = run_each(engine, network, forced(network, steps, times), *watched)
        assert int(raster.sum()) == 3
        results.append([values[::scale, 0] for values in seen])
    for whole, halved in zip(*results, strict=True):
        assert whole.abs().max() > 0
        torch.testing.assert_close(whole, halved, rtol=1e-12, atol=1e-15)
    peak = 0.1 * math.exp(-gap / 20.0)
    assert float(results[0][0][first + gap]) == float(results[0][0].max())
    torch.testing.assert_close(float(results[0][0].max()), peak, rtol=1e-12, atol=0)
