"""Discs that stop the robot: where it stops, by hand, in the world as written and compiled; what cannot be placed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from helpers import make_world, place
from labels import faults
from torch import Tensor

from snnrl.beyond import obstacles
from snnrl.beyond.course import Course
from snnrl.body.world import World
from snnrl.configuration.builder import build_world
from snnrl.configuration.checks import check
from snnrl.configuration.compose import compose
from snnrl.engines import compiled_world
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws
from snnrl.schema import KindConfig

WAY = 28.1 * 0.07  # cm, in a tick
STRAIGHT = torch.tensor([[28.1, 28.1]], dtype=torch.float64)
RADIUS = 5.0


def world_with(centre: tuple[float, float], position: tuple[float, float], heading: float, **more: Any) -> World:
    """A world of side 100 with one obstacle, and the robot somewhere."""
    world = make_world(side=150.0, obstacle=KindConfig(1, RADIUS, "stops"), **more)
    place(world, position, heading)
    world.places[0, 0] = torch.tensor(centre, dtype=torch.float64)
    return world


def step(world: World, compiled: bool, wheels: Tensor = STRAIGHT) -> bool:
    """One tick; whether the obstacle was touched."""
    now = torch.zeros((), dtype=torch.int64)
    if not compiled:
        return bool(world.step(wheels, now)["obstacle"][0])
    machine = compiled_world("fused", world, [], ["obstacle"])
    assert machine is not None
    return bool(machine.step(wheels, 0, torch.zeros(1, 2, dtype=torch.int64))[0][0, 0])


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize(
    ("centre", "position", "heading", "gone"),
    [
        ((50.0, 50.0), (44.0, 50.0), 0.0, 1.0),  # head on, 1 cm off
        ((50.0, 50.0), (44.0, 50.0), math.pi, WAY),  # away
        ((50.0, 50.0), (45.0, 50.0), 0.0, 0.0),  # at the edge
        ((50.0, 50.0), (45.0, 50.0), 0.5 * math.pi, WAY),  # along it
        ((50.0, 50.0), (50.0 - WAY - RADIUS - 0.01, 50.0), 0.0, WAY),  # not yet
        ((50.0, 50.0), (46.0, 46.0), 0.0, 1.0),  # 4 cm aside: the edge is 3 cm before the centre
        ((50.0, 50.0), (49.0, 44.0), 0.0, WAY),  # passes by
        ((2.0, 50.0), (146.0, 50.0), 0.0, 1.0),  # over the edge of the torus
        ((149.0, 148.0), (149.0, 3.5), 1.5 * math.pi, 0.5),  # and over the other
        ((50.0, 50.0), (51.0, 50.0), 0.0, WAY),  # from inside it may leave
        ((50.0, 50.0), (49.0, 50.0), 0.0, 0.0),  # but not cross
    ],
)
def test_the_robot_goes_as_far_as_the_edge_and_turns_all_the_same(
    compiled: bool, centre: tuple[float, float], position: tuple[float, float], heading: float, gone: float
) -> None:
    world = world_with(centre, position, heading)
    touched = step(world, compiled)
    expected = [(at + gone * f(heading)) % 150 for at, f in zip(position, (math.cos, math.sin), strict=True)]
    assert world.position[0].tolist() == pytest.approx(expected, abs=1e-12)
    assert touched == (gone < WAY)
    assert world.touches[0].tolist()[-1] == touched
    world = world_with(centre, position, heading)
    step(world, compiled, torch.tensor([[25.0, 31.2]], dtype=torch.float64))
    assert float(world.heading[0]) == pytest.approx((heading + 6.2 * 0.07) % (2 * math.pi), abs=1e-12)


@pytest.mark.parametrize("compiled", [False, True])
def test_the_first_of_two_stops_it_and_is_the_one_that_is_felt(compiled: bool) -> None:
    world = world_with((50.0, 50.0), (44.0, 50.0), 0.0, other=KindConfig(1, 2.0, "stops"))
    world.places[0, 1] = torch.tensor([46.5, 50.0], dtype=torch.float64)
    assert not step(world, compiled)
    assert world.position[0].tolist() == pytest.approx([44.5, 50.0])
    assert world.touches[0].tolist()[-2:] == [0, 1]


def crowded(trials: int = 4) -> World:
    coding, world = compose("+experiment=obstacles", "world.kinds.obstacle.count=9").body()
    return build_world(world, coding, Draws(3_000_000, torch.arange(trials)))


def test_both_worlds_are_the_same_bit_for_bit_and_no_robot_gets_in() -> None:
    one, other = crowded(), crowded()
    machine = compiled_world("fused", other, list(other.config.ranges), ["obstacle", "food"])
    assert machine is not None
    taken = torch.zeros(4, 2, dtype=torch.int64)
    choices = torch.rand(600, 4, generator=torch.Generator().manual_seed(0)) < 0.5
    for tick, right in enumerate(choices):
        wheels = torch.where(right[:, None], torch.tensor([31.2, 25.0]), torch.tensor([25.0, 31.2])).double()
        felt = one.step(wheels, torch.tensor(70 * tick))
        senses, _ = machine.step(wheels, 70 * tick, taken)
        assert senses[:, -2:].equal(torch.stack([felt["obstacle"], felt["food"]], 1).double())
        assert one.position.equal(other.position)
        assert one.places.equal(other.places)
        assert torch.cat(list(one.sense().values()), 1).equal(senses[:, :-2])
        assert distances(one, "obstacle").min() > RADIUS - 1e-9
    assert (one.count("obstacle") > 0).all()
    assert (one.count("food") > 0).all()


def distances(world: World, kind: str) -> Tensor:
    """From the robots to all objects of a kind, [B, n]."""
    way = (world.places[:, world.kinds.index(kind)] - world.position[:, None]).abs()
    return torch.minimum(way, world.config.side - way).norm(dim=2)


def test_nothing_lands_on_an_obstacle() -> None:
    world = crowded(20)
    of_kind = {kind: world.places[:, world.kinds.index(kind)] for kind in ("food", "obstacle")}
    for kind, radius in (("food", 2.4 + RADIUS), ("obstacle", 2 * RADIUS)):
        way = (of_kind[kind][:, :, None] - of_kind["obstacle"][:, None]).abs()
        apart = torch.minimum(way, world.config.side - way).norm(dim=3)
        if kind == "obstacle":
            apart += 1e3 * torch.eye(9)
        assert float(apart.min()) >= radius
    assert float(distances(world, "obstacle").min()) >= RADIUS


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        ("world.kinds.obstacle.radius=0", "world.kinds.obstacle.radius=0.0: must be greater than 0"),
        ("world.kinds.obstacle.radius=48.5", "world.kinds.obstacle.radius=48.5: must be less than 48.033, half of"),
        ("world.kinds.obstacle.count=-1", "world.kinds.obstacle.count=-1: must be at least 0"),
        (
            "world.kinds.obstacle.count=33",
            "world.kinds.obstacle.count=33: must be at most 32, if there is to be a place",
        ),
        (
            "world.kinds.food.avoids=[obstacle]",
            "world.kinds.food.avoids=obstacle: must be one of robot, obs",
        ),
    ],
)
def test_what_cannot_be_is_refused(overrides: str, line: str) -> None:
    with pytest.raises(ConfigError, match="^" + line.replace(".", r"\.")):
        check(compose("+experiment=obstacles", overrides))


def test_contact_is_counted_early_and_late() -> None:
    contact = np.array([6, 6, 4, 4, 4, 3, 3, 2, 2, 1])[:, None] * np.ones(2)
    touches = {"obstacle": contact, "food": 10 - contact}
    course = Course("no_pain", 50.0, touches, {kind: np.ones(10) for kind in touches})
    assert (50 * obstacles.early(course, "obstacle")).tolist() == [6.0, 6.0]
    assert (50 * obstacles.late(course, "obstacle")).tolist() == [1.5, 1.5]
    row = obstacles._table([course], course).splitlines()[2].split(" | ")
    assert row[3:5] == ["0.25", "1.00"]
    assert row[-1] == "1.00 |"
    assert not faults(obstacles.figure_of([course]))
