"""Whose the change of a weight is: that it adds up, by hand, and beside the ledger of a replay."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from labels import faults

from snnrl.beyond import credit
from snnrl.beyond.account import Account
from snnrl.beyond.booking import CLIPPED, DAMPENED, HUNGER, PARTS, ROUNDING, SOURCES
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.replay.credit import Ledger

FOOD = ("+experiment=food_attraction", "seconds=14", "threads=1")
CAPTURED = ("+robot.weights.food_attraction=3.9", "+robot.weights.food_avoidance=0.2")  # over the limit of their mean


def accounted(*overrides: str, ticks: int = 200) -> Account:
    config = compose(*FOOD, *overrides)
    simulation, engine = build(config), make_engine(config.engine, "cpu", 1)
    account = Account(simulation)
    account.run(simulation, engine, ticks)
    return account


def test_all_parts_add_up_to_the_change_of_each_projection() -> None:
    account = accounted(*CAPTURED, "trials=3")
    parts = account.books.parts
    for k, projection in enumerate(account.projections):
        start = 3.9 if projection.role == "food_attraction" else 0.2
        change = projection.total(projection.weight.double() - torch.tensor(start).double()).numpy()
        np.testing.assert_allclose(parts[:, k].sum(1), change, atol=1e-9)
    assert np.abs(parts[..., ROUNDING]).max() < 1e-2  # of 400 synapses at float32, 200 ticks long
    for part in (0, HUNGER, CLIPPED, DAMPENED):
        assert (np.abs(parts[..., part]) > 0.1).any(), PARTS[part]


def test_each_part_is_that_of_the_ledger_of_a_replay() -> None:
    """The ledger steps `Network.learn` itself. It books transients, so all that there is where there is no hunger."""
    ticks, words = 60, (*CAPTURED, "robot=no_hunger", "trials=1")
    ledger = Ledger(build(compose(*FOOD, *words, "dtype=float64")).network)
    simulation, engine = build(compose(*FOOD, *words)), make_engine("auto", "cpu", 1)
    raster = torch.zeros(simulation.tick, 1, simulation.network.size, dtype=torch.bool)
    world, learnt = simulation.situation.world, slice(len(ledger.weight))
    ledger.weight.copy_(simulation.network.synapses.weight[learnt])
    for _ in range(ticks):
        simulation.run(engine, 1, raster)
        ledger.follow(raster, float(world.sign[0]), "any", simulation.network.synapses.weight[learnt])
    assert int(world.touches.sum()) > 1
    account = accounted(*words, ticks=ticks)
    assert account.books.level.sum() == pytest.approx(ledger.levels[-1], abs=1e-12)
    np.testing.assert_allclose(account.books.eligibility, ledger.eligibility.numpy(), atol=1e-12)
    parts = account.books.parts.sum((0, 1))
    for found, booked in ((parts[: HUNGER + 1].sum(), "driven"), (parts[CLIPPED], "clipped")):
        assert found == pytest.approx(sum(getattr(reward, booked).sum() for reward in ledger.rewards), rel=0.02)


def test_without_a_baseline_there_is_no_hunger_and_without_containers_no_touch_of_them() -> None:
    parts = accounted("robot=no_hunger", "trials=2").books.parts
    assert (parts[..., HUNGER] == 0).all()
    assert (parts[..., SOURCES.index("container")] == 0).all()
    assert (parts[..., SOURCES.index("food")] != 0).any()


def test_every_role_has_its_row() -> None:
    time, roles = credit.course(compose(*FOOD, "trials=2"), 0.5)
    assert time[0] == 0
    assert time[-1] == pytest.approx(7.0)
    assert list(roles) == ["food_avoidance", "food_attraction"]
    assert all(parts.shape == (len(time), 2, len(PARTS)) for parts in roles.values())
    assert all((parts[0] == 0).all() for parts in roles.values())
    assert credit._table({"food": (time, roles)}).count("\n") == 4
    assert not faults(credit.figure_of({"food": (time, roles)}))


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (("+experiment=food_attraction", "robot=random_walk"), "robot=...: must learn from dopamine"),
        (("+experiment=avoidance",), "network.rules=...: credit is counted of one rule"),
        (
            ("+experiment=food_attraction", "network.plasticity.simultaneous=potentiates"),
            "network.plasticity=...: must",
        ),
        (("+experiment=food_attraction", "network.dopamine.smoothing=9"), "network.dopamine=...: must be released by"),
    ],
)
def test_what_cannot_be_accounted_for_is_refused(overrides: tuple[str, ...], line: str) -> None:
    with pytest.raises(ConfigError, match="^" + line.replace(".", r"\.")):
        Account(build(compose(*overrides, "trials=1", "seconds=1")))
