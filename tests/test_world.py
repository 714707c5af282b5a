"""The torus, the robot's motion, what it senses and touches; hand-made situations in every engine."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import ENGINES, containers, items, make_simulation, make_world, place
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from snnrl.body.world import World
from snnrl.body.world.geometry import drive, in_disc, offset
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.model.draws import stream
from snnrl.schema import KindConfig
from snnrl.simulation import Simulation

TICK = 0.07  # s
STILL = torch.zeros(1, 2, dtype=torch.float64)
NOW = torch.tensor(0)
EQUAL = (28.1, 28.1)


def double(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def drove(
    position: tuple[float, float], heading: float, wheels: tuple[float, float], seconds: float = TICK
) -> tuple[list[float], float]:
    """Where a robot of axle 1 cm is after one step on a torus of side 100."""
    x, y, left, right = double(*position, *wheels)
    x, y, turned = drive(x, y, double(heading)[0], left, right, seconds, 1.0, 100.0, double(math.inf)[0])
    return [float(x), float(y)], float(turned)


@pytest.mark.parametrize(
    ("origin", "target", "way"),
    [
        (10.0, 30.0, 20.0),
        (30.0, 10.0, -20.0),
        (95.0, 5.0, 10.0),
        (5.0, 95.0, -10.0),
        (0.0, 0.0, 0.0),
        (0.0, 49.0, 49.0),
        (0.0, 51.0, -49.0),
        (0.0, 50.0, -50.0),  # exactly half the side: both ways are as long
        (50.0, 0.0, -50.0),
        (99.5, 0.0, 0.5),
    ],
)
def test_shortest_offset(origin: float, target: float, way: float) -> None:
    assert float(offset(double(origin), double(target), 100.0)) == way


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.floats(0, 299.999), st.floats(0, 299.999))
def test_offset_leads_to_the_target_and_is_never_longer_than_half_the_side(origin: float, target: float) -> None:
    way = float(offset(double(origin), double(target), 300.0))
    assert -150.0 <= way < 150.0
    missed = (origin + way - target) / 300.0
    assert missed == pytest.approx(round(missed), abs=1e-12)


@pytest.mark.parametrize("heading", [0.0, 1.0, 0.5 * math.pi, 4.0])
def test_equal_wheels_drive_straight(heading: float) -> None:
    position, turned = drove((50.0, 40.0), heading, EQUAL)
    way = 28.1 * TICK
    assert position == pytest.approx([50 + way * math.cos(heading), 40 + way * math.sin(heading)], abs=1e-12)
    assert turned == pytest.approx(heading, abs=1e-12)


@pytest.mark.parametrize(("wheels", "turn"), [((25.0, 31.2), 6.2 * TICK), ((31.2, 25.0), -6.2 * TICK)])
def test_position_moves_along_the_old_heading_and_then_the_heading_turns(
    wheels: tuple[float, float], turn: float
) -> None:
    """A faster right wheel turns to the left, anticlockwise."""
    position, turned = drove((50.0, 40.0), 1.0, wheels)
    way = 28.1 * TICK
    assert position == pytest.approx([50 + way * math.cos(1.0), 40 + way * math.sin(1.0)], abs=1e-12)
    assert turned == pytest.approx(1.0 + turn, abs=1e-12)


@pytest.mark.parametrize("corners", [3, 14, 200])
@pytest.mark.parametrize("wheels", [(25.0, 31.2), (31.2, 25.0)])
def test_one_full_turn_is_a_closed_regular_polygon(wheels: tuple[float, float], corners: int) -> None:
    """Its corners lie on a circle; with many of them its radius is the smallest turning radius, 4.53 cm."""
    seconds = 2 * math.pi / 6.2 / corners
    position, heading = [50.0, 50.0], 0.3
    path = []
    for _ in range(corners):
        path.append(position)
        position, heading = drove((position[0], position[1]), heading, wheels, seconds)
    assert position == pytest.approx([50.0, 50.0], abs=1e-9)
    assert math.sin(heading - 0.3) == pytest.approx(0.0, abs=1e-9)
    centre = [sum(axis) / corners for axis in zip(*path, strict=True)]
    radius = 28.1 * seconds / 2 / math.sin(math.pi / corners)
    assert [math.dist(point, centre) for point in path] == pytest.approx([radius] * corners, abs=1e-9)
    if corners == 200:
        assert radius == pytest.approx(4.53, abs=0.005)


@pytest.mark.parametrize(
    ("position", "heading", "expected"),
    [
        ((99.0, 50.0), 0.0, (0.967, 50.0)),
        ((1.0, 50.0), math.pi, (99.033, 50.0)),
        ((50.0, 99.0), 0.5 * math.pi, (50.0, 0.967)),
        ((50.0, 1.0), 1.5 * math.pi, (50.0, 99.033)),
        ((99.0, 99.5), 0.25 * math.pi, (99 + 1.967 / 2**0.5 - 100, 99.5 + 1.967 / 2**0.5 - 100)),
        ((1.0, 99.5), 0.75 * math.pi, (101 - 1.967 / 2**0.5, 99.5 + 1.967 / 2**0.5 - 100)),
        ((1.0, 0.5), 1.25 * math.pi, (101 - 1.967 / 2**0.5, 100.5 - 1.967 / 2**0.5)),
        ((99.0, 0.5), 1.75 * math.pi, (99 + 1.967 / 2**0.5 - 100, 100.5 - 1.967 / 2**0.5)),
    ],
)
def test_the_robot_leaves_over_an_edge_or_corner_and_comes_back_opposite(
    position: tuple[float, float], heading: float, expected: tuple[float, float]
) -> None:
    assert drove(position, heading, EQUAL)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("heading", "wheels", "expected"),
    [(6.2, (25.0, 31.2), 6.2 + 0.434 - 2 * math.pi), (0.1, (31.2, 25.0), 0.1 - 0.434 + 2 * math.pi)],
)
def test_heading_stays_within_one_turn(heading: float, wheels: tuple[float, float], expected: float) -> None:
    assert drove((50.0, 50.0), heading, wheels)[1] == pytest.approx(expected, abs=1e-12)


def test_points_in_a_disc_reach_its_border_and_have_half_their_number_in_half_its_area() -> None:
    uniform = torch.rand(4000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    points = torch.stack(in_disc(double(14.0), *uniform.unbind(1)), 1)
    distance = points.norm(dim=1)
    assert 13.9 < float(distance.max()) <= 14.0
    assert float((distance < 14.0 / 2**0.5).double().mean()) == pytest.approx(0.5, abs=0.03)
    assert points.mean(0).tolist() == pytest.approx([0.0, 0.0], abs=0.5)


def seen(
    items: list[list[float]],
    heading: float = 0.0,
    position: tuple[float, float] = (50.0, 50.0),
    to_border: bool = True,
    side: float = 100.0,
    answers: str = "nearer",
) -> list[float]:
    """What the left and the right food sensor see of free items."""
    world = make_world(free_items=len(items), side=side, to_border=to_border)
    world.config.ranges["food"].answers = answers
    place(world, position, heading, items)
    return world.sense()["food"][0].tolist()


def at(angle: float, distance: float, position: tuple[float, float] = (50.0, 50.0)) -> list[float]:
    """A place at an angle (degrees) and a distance from a position; exact along the axes."""
    ways = {0: (1.0, 0.0), 90: (0.0, 1.0), 180: (-1.0, 0.0), -90: (0.0, -1.0)}
    x, y = (
        ways.get(int(angle), (0.0, 0.0))
        if angle in ways
        else (math.cos(math.radians(angle)), math.sin(math.radians(angle)))
    )
    return [position[0] + distance * x, position[1] + distance * y]


@pytest.mark.parametrize(
    ("angle", "eyes"),
    [
        (0, "left"),
        (1, "left"),
        (45, "left"),
        (89, "left"),
        (90, "left"),
        (91, ""),
        (135, ""),
        (180, ""),
        (-135, ""),
        (-91, ""),
        (-90, "right"),
        (-89, "right"),
        (-45, "right"),
        (-1, "right"),
    ],
)
def test_each_eye_sees_from_straight_ahead_to_90_degrees_on_its_side(angle: float, eyes: str) -> None:
    value = 1 - (10 - 2.4) / 30
    expected = {"left": [value, 0.0], "right": [0.0, value], "": [0.0, 0.0]}[eyes]
    assert seen([at(angle, 10.0)]) == pytest.approx(expected, abs=1e-12)
    if angle not in (0, 90, -90):  # where rounding of another heading decides
        for turned in (40.0, 200.0, 355.0):
            found = seen([at(angle + turned, 10.0)], math.radians(turned))
            assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("left", "right"), [(10.0, 12.0), (12.0, 10.0)])
def test_the_eye_with_the_nearer_object_answers_or_both_do(left: float, right: float) -> None:
    """Each of them with its nearest one."""
    values = [1 - (distance - 2.4) / 30 for distance in (left, right)]
    items = [at(angle, way) for angle, way in ((45, 20.0), (45, left), (-45, right), (-45, 20.0), (135, 5.0))]
    assert seen(items) == pytest.approx([value * (value == max(values)) for value in values], abs=1e-12)
    assert seen(items, answers="both") == pytest.approx(values, abs=1e-12)
    assert seen(items[3:], answers="both") == pytest.approx([0.0, 1 - 17.6 / 30], abs=1e-12)


@pytest.mark.parametrize(
    ("distance", "value"),
    [
        (0.0, 1.0),
        (1.0, 1.0),
        (2.4, 1.0),
        (3.9, 0.95),
        (17.4, 0.5),
        (32.0, 0.4 / 30),
        (32.4, 0.0),
        (35.0, 0.0),
    ],
)
def test_value_falls_from_the_border_of_the_object(distance: float, value: float) -> None:
    assert sum(seen([at(30, distance)])) == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize(("distance", "value"), [(0.0, 1.0), (2.4, 0.92), (15.0, 0.5), (29.7, 0.01), (30.0, 0.0)])
def test_value_falls_from_the_centre_of_the_object(distance: float, value: float) -> None:
    assert sum(seen([at(30, distance)], to_border=False)) == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize(
    ("distance", "to_border", "value"),
    [(14.001, True, 1.0), (44.0, True, 0.5), (74.0, True, 0.0), (30.0, False, 0.5), (60.0, False, 0.0)],
)
def test_containers_are_seen_from_farther(distance: float, to_border: bool, value: float) -> None:
    world = make_world(empty_containers=1, to_border=to_border)
    place(world, (50.0, 50.0), 0.0, [], [at(-20, distance)])
    assert world.sense()["container"][0].tolist() == pytest.approx([0.0, value], abs=1e-4)
    assert world.sense()["food"][0].tolist() == [0.0, 0.0]


def test_only_the_nearest_object_is_seen() -> None:
    near, value = at(60, 8.0), 1 - (8 - 2.4) / 30
    assert seen([near, at(10, 9.0)]) == pytest.approx([value, 0.0])
    assert seen([at(10, 9.0), near]) == pytest.approx([value, 0.0])


def test_only_the_stronger_eye_answers() -> None:
    left, right = at(30, 11.0), at(-30, 10.0)
    assert seen([left, right]) == pytest.approx([0.0, 1 - 7.6 / 30])
    assert seen([at(30, 9.0), right]) == pytest.approx([1 - 6.6 / 30, 0.0])


def test_a_nearer_object_behind_does_not_hide_one_ahead() -> None:
    assert seen([at(170, 4.0), at(-30, 10.0)]) == pytest.approx([0.0, 1 - 7.6 / 30])


@pytest.mark.parametrize(
    ("position", "heading", "item", "expected"),
    [
        ((99.0, 50.0), 0.0, [5.0, 50.5], (1.0, 0.0)),
        ((1.0, 50.0), math.pi, [95.0, 50.5], (0.0, 1.0)),
        ((50.0, 99.0), 0.5 * math.pi, [50.5, 5.0], (0.0, 1.0)),
        ((99.0, 99.0), 0.25 * math.pi, [3.0, 4.0], (1.0, 0.0)),
    ],
)
def test_sees_over_the_edge_of_the_torus(
    position: tuple[float, float], heading: float, item: list[float], expected: tuple[float, float]
) -> None:
    way = [(to - of + 50) % 100 - 50 for to, of in zip(item, position, strict=True)]
    value = 1 - (math.hypot(*way) - 2.4) / 30
    assert seen([item], heading, position) == pytest.approx([value * eye for eye in expected], abs=1e-12)


def test_a_world_without_objects_is_dark() -> None:
    world = make_world()
    assert {name: values[0].tolist() for name, values in world.sense().items()} == {
        "food": [0.0, 0.0],
        "container": [0.0, 0.0],
    }


@pytest.mark.parametrize(
    ("origin", "distance", "taken"),
    [
        ((0.0, 50.0), 0.0, True),
        ((0.0, 50.0), 2.399999, True),
        ((0.0, 50.0), 2.4, False),
        ((0.0, 50.0), 2.400001, False),
        ((299.0, 50.0), 2.399999, True),
        ((299.0, 50.0), 2.400001, False),
    ],
)
def test_an_item_is_taken_at_less_than_its_radius(origin: tuple[float, float], distance: float, taken: bool) -> None:
    world = make_world(trials=2, free_items=2)
    for trial in range(2):
        place(world, origin, 0.0, [[(origin[0] + distance) % 300, origin[1]], [150.0, 150.0]], trial=trial)
    world.places[1, 0] = double(200.0, 200.0)
    before = items(world)
    touched = world.step(torch.zeros(2, 2, dtype=torch.float64), torch.tensor(700))
    assert touched["food"].tolist() == [taken, False]
    assert world.touches.tolist() == [[int(taken), 0, 0], [0, 0, 0]]
    assert bool((items(world)[0, 0] != before[0, 0]).all()) is taken
    assert torch.equal(items(world)[0, 1], before[0, 1])
    assert torch.equal(items(world)[1], before[1])
    assert bool(((items(world) >= 0) & (items(world) < 300)).all())


def test_items_of_one_tick_are_counted_each_and_land_in_different_places() -> None:
    world = make_world(free_items=3)
    place(world, (50.0, 50.0), 0.0, [[50.0, 51.0], [51.0, 50.0], [60.0, 60.0]])
    assert bool(world.step(STILL, NOW)["food"])
    assert world.touches.tolist() == [[2, 0, 0]]
    assert not torch.equal(items(world)[0, 0], items(world)[0, 1])


def test_places_of_replaced_items_differ_from_tick_to_tick() -> None:
    found = []
    for time in (70, 140):
        world = make_world(free_items=1)
        place(world, (50.0, 50.0), 0.0, [[50.0, 51.0]])
        world.step(STILL, torch.tensor(time))
        found.append(items(world).clone())
    assert not torch.equal(*found)


@pytest.mark.parametrize("kind", ["free_items", "food_containers"])
def test_what_is_taken_in_the_first_tick_lands_elsewhere(kind: str) -> None:
    world = make_world(20, int(kind == "free_items"), int(kind == "food_containers"))
    before = items(world).clone()
    world.position.copy_(items(world)[:, 0])
    world.inside.fill_(-1 if kind == "free_items" else 0)
    world.step(torch.zeros(20, 2, dtype=torch.float64), NOW)
    assert world.touches[:, 0].tolist() == [1] * 20
    assert bool((items(world) != before).all())


def test_the_robot_moves_before_it_touches() -> None:
    world = make_world(free_items=2)
    place(world, (50.0, 50.0), 0.0, [[54.0, 50.0], [48.0, 50.0]])
    world.step(double(*EQUAL)[None], NOW)  # 1.967 cm: towards one, away from the other
    assert world.touches.tolist() == [[1, 0, 0]]
    assert items(world)[0, 1].tolist() == [48.0, 50.0]


@pytest.mark.parametrize(("kind", "counts"), [("food", [0, 1, 0]), ("empty", [0, 0, 1])])
def test_a_container_is_felt_once_when_entered_and_again_after_leaving(kind: str, counts: list[int]) -> None:
    food = int(kind == "food")
    world = make_world(food_containers=food, empty_containers=1 - food)
    place(world, (36.5, 50.0), 0.0, [[60.0, 50.0]] * food, [[50.0, 50.0]])
    wheels = double(*EQUAL)[None]
    name = "food_container" if food else "empty_container"
    felt = []
    for _ in range(3):  # enters in the first tick: 13.5 is within the 14 cm
        felt.append(bool(world.step(wheels, NOW)[name]))
    assert felt == [True, False, False]
    assert world.touches.tolist() == [counts]
    assert world.inside.tolist() == [0]
    world.position.copy_(double(20.0, 50.0)[None])
    assert not bool(world.step(STILL, NOW)[name])
    assert world.inside.tolist() == [-1]
    world.position.copy_(double(50.0, 63.0)[None])
    assert bool(world.step(STILL, NOW)[name])
    assert world.touches.tolist() == [[2 * count for count in counts]]


@pytest.mark.parametrize(("distance", "inside"), [(13.999, 0), (14.0, -1), (14.001, -1)])
def test_a_container_is_entered_at_less_than_its_radius(distance: float, inside: int) -> None:
    world = make_world(empty_containers=1)
    place(world, (0.0, 50.0), 0.0, [], [[distance, 50.0]])
    world.step(STILL, NOW)
    assert world.inside.tolist() == [inside]


def test_a_container_is_entered_over_the_edge_of_the_torus() -> None:
    world = make_world(empty_containers=1)
    place(world, (295.0, 298.0), 0.0, [], [[3.0, 2.0]])
    world.step(STILL, NOW)
    assert world.inside.tolist() == [0]


def test_of_overlapping_containers_the_nearest_is_entered_and_kept() -> None:
    world = make_world(food_containers=1, empty_containers=1)
    place(world, (48.0, 50.0), 0.0, [[30.0, 50.0]], [[40.0, 50.0], [60.0, 50.0]])
    world.step(STILL, NOW)
    assert world.inside.tolist() == [0]
    world.position.copy_(double(53.0, 50.0)[None])  # now nearer to the other, but still in the first
    world.step(STILL, NOW)
    assert (world.inside.tolist(), world.touches.tolist()) == ([0], [[0, 1, 0]])
    world.position.copy_(double(55.0, 50.0)[None])
    world.step(STILL, NOW)
    assert (world.inside.tolist(), world.touches.tolist()) == ([1], [[0, 1, 1]])


def test_with_nearest_the_robot_is_in_the_container_whose_centre_is_nearest() -> None:
    """The same way through the same two containers, and back; each change is a touch."""
    world = make_world(food_containers=1, empty_containers=1, overlap="nearest")
    place(world, (48.0, 50.0), 0.0, [[30.0, 50.0]], [[40.0, 50.0], [60.0, 50.0]])
    for x, inside, touches in ((48, 0, [0, 1, 0]), (53, 1, [0, 1, 1]), (55, 1, [0, 1, 1]), (49, 0, [0, 2, 1])):
        world.position.copy_(double(x, 50.0)[None])
        world.step(STILL, NOW)
        assert (world.inside.tolist(), world.touches.tolist()) == ([inside], [touches])
    world.position.copy_(double(80.0, 50.0)[None])
    world.step(STILL, NOW)
    assert world.inside.tolist() == [-1]


def gaps(world: World) -> Tensor:
    """From each container's centre to that of the nearest other one, [B, n]."""
    places = containers(world)
    way = offset(places[:, :, None], places[:, None], world.config.side).norm(dim=3)
    return torch.where(torch.eye(places.shape[1], dtype=torch.bool), torch.inf, way).amin(2)


def empty_all(world: World, ticks: int) -> None:
    """Let the robot take the food of one container after the other."""
    for tick in range(1, ticks + 1):
        world.position.copy_(items(world)[:, tick % items(world).shape[1]])
        world.inside.fill_(-1)
        world.step(torch.zeros(len(world.heading), 2, dtype=torch.float64), torch.tensor(70 * tick))


@pytest.mark.parametrize("avoids", [[], ["robot"], ["containers"], ["robot", "containers"]])
def test_a_container_lands_only_where_it_may(avoids: list[str]) -> None:
    """20 worlds of 8 containers on 130 x 130 cm, of which some overlap or lie on the robot where they may."""
    world = make_world(20, food_containers=8, side=130.0, attempts=200, avoids=avoids)
    seen = []
    for ticks in (0, 1, 1, 1, 6):
        empty_all(world, ticks)
        on_robot = offset(containers(world), world.position[:, None], 130.0).norm(dim=2).amin(1) < 14.0
        seen.append((float(gaps(world).min()), int(on_robot.sum())))
        world.heading.zero_()
    assert all((gap >= 28.0) is ("containers" in avoids) for gap, _ in seen)
    distance = offset(containers(world), items(world), 130.0).norm(dim=2)
    assert float(distance.max()) < 14.0
    if "robot" in avoids:
        assert seen[0][1] == 0
        assert avoids == ["robot"] or not any(count for _, count in seen)
    else:
        assert seen[0][1] > 0


def test_a_container_lands_on_the_first_place_that_is_clear_or_on_the_last_drawn() -> None:
    """Places tried are further numbers of its own stream, four a time."""
    for attempts, chosen in ((50, None), (3, 2)):
        world = make_world(1, food_containers=2, side=70.0, attempts=attempts, avoids=["containers"])
        place(world, (0.0, 0.0), 0.0, [[0.0, 0.0], [35.0, 40.0]], [[0.0, 0.0], [35.0, 35.0]], inside=0)
        if chosen == 2:
            world.kinds.radius[1] = 49.0  # nothing is clear of it: 98 cm are more than half the diagonal
        world.step(STILL, torch.tensor(700))
        drawn = world.draws.uniform(stream("moved", "food_container"), torch.tensor([700]), 8 * attempts)[0, 0]
        tried = 70.0 * drawn.view(attempts, 2, 4)[:, 0, :2]
        clear = offset(tried, double(35.0, 35.0), 70.0).norm(dim=1) >= 28.0
        which = int(clear.long().argmax()) if chosen is None else chosen
        assert which > 0
        assert torch.equal(containers(world)[0, 0], tried[which])
        assert containers(world)[0, 1].tolist() == [35.0, 35.0]


@pytest.mark.parametrize(("contains", "largest"), [("centre", 14.0), ("whole", 11.6)])
def test_an_item_may_lie_wholly_inside_its_container(contains: str, largest: float) -> None:
    world = make_world(trials=200, food_containers=4, contains=contains)
    for ticks in (0, 4):
        empty_all(world, ticks)
        distance = offset(containers(world), items(world), 300.0).norm(dim=2)
        assert largest - 0.2 < float(distance.max()) <= largest + 1e-9
        assert float((distance < largest / 2**0.5).double().mean()) == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            "world.kinds.food_container.avoids=[walls]",
            r"food_container\.avoids=walls: must be one of robot, obstacles, containers",
        ),
        ("world.kinds.food_container.turns_every=9", r"food_container\.turns_every=9\.0: needs touched=taken"),
        ("world.kinds.food.turns_every=0", r"food\.turns_every=0\.0: must be at least 0\.001"),
        ("world.kinds.food.contains=whole", r"food\.contains=whole: needs holds"),
        ("world.kinds.food_container.radius=2.4", r"food_container\.radius=2\.4: must be greater than 2\.4, .* food"),
        ("world.overlap=both", r"world\.overlap=both: must be one of stays, nearest"),
        ("world.attempts=0", r"world\.attempts=0: must be at least 1"),
    ],
)
def test_what_makes_no_sense_of_containers_is_refused(options: str, message: str) -> None:
    whole = "world.kinds.food_container.contains=whole"
    with pytest.raises(ConfigError, match=message):
        make_simulation("+experiment=dual_learning", "trials=1", whole, options)


def test_food_in_a_container_is_sensed_and_touched_from_inside_only() -> None:
    world = make_world(trials=2, food_containers=1)
    for trial, x in enumerate((35.5, 36.5)):  # 0.5 cm outside, 0.5 cm inside
        place(world, (x, 50.0), 0.0, [[37.5, 50.0]], [[50.0, 50.0]], trial=trial)
    world.kinds.radius[0] = 0.1
    world.step(torch.zeros(2, 2, dtype=torch.float64), NOW)
    assert world.inside.tolist() == [-1, 0]
    assert world.sense()["food"][0].tolist() == [0.0, 0.0]
    assert world.sense()["food"][1].tolist() == pytest.approx([1 - 0.9 / 30, 0.0])
    world.kinds.radius[0] = 2.4
    touched = world.step(torch.zeros(2, 2, dtype=torch.float64), NOW)
    assert touched["food"].tolist() == [False, True]


def test_from_inside_only_its_own_food_is_sensed_and_no_container() -> None:
    """Free items, food of other containers and the containers themselves are hidden."""
    world = make_world(free_items=1, food_containers=2)
    objects = [[55.0, 50.0], [60.0, 52.0], [58.0, 50.0]]
    place(world, (50.0, 50.0), 0.0, objects, [[50.0, 51.0], [70.0, 50.0]], inside=0)
    distance = math.hypot(10.0, 2.0)
    assert world.sense()["food"][0].tolist() == pytest.approx([1 - (distance - 2.4) / 30, 0.0])
    assert world.sense()["container"][0].tolist() == [0.0, 0.0]
    place(world, (50.0, 50.0), 0.0, objects, [[50.0, 51.0], [70.0, 50.0]], inside=-1)
    assert world.sense()["food"][0].tolist() == pytest.approx([1 - (5 - 2.4) / 30, 0.0])
    assert world.sense()["container"][0].tolist() == [1.0, 0.0]


def test_free_items_are_not_taken_from_inside_a_container() -> None:
    world = make_world(free_items=1, food_containers=1)
    place(world, (50.0, 50.0), 0.0, [[51.0, 50.0], [60.0, 50.0]], [[50.0, 50.0]], inside=0)
    world.step(STILL, NOW)
    assert world.touches.tolist() == [[0, 0, 0]]


@pytest.mark.parametrize(("inside", "factor"), [(-1, 1.0), (0, 0.5), (1, 0.5)])
def test_inside_any_container_both_wheels_have_half_their_speed(inside: int, factor: float) -> None:
    """Also the turn is halved; the speed is that of where the tick began."""
    world = make_world(food_containers=1, empty_containers=1)
    place(world, (50.0, 50.0), 0.0, [[60.0, 50.0]], [[50.0, 50.0], [50.0, 51.0]], inside=inside)
    world.step(double(25.0, 31.2)[None], NOW)
    assert world.position[0].tolist() == pytest.approx([50 + factor * 28.1 * TICK, 50.0])
    assert world.heading.tolist() == pytest.approx([factor * 6.2 * TICK])


def test_a_container_moves_with_its_item_when_that_is_taken() -> None:
    trials = 40
    world = make_world(trials=trials, food_containers=2, empty_containers=1)
    for trial in range(trials):
        place(
            world,
            (50.0, 50.0),
            0.0,
            [[99.0, 50.0], [51.0, 50.0]],
            [[100.0, 50.0], [50.0, 60.0], [200.0, 200.0]],
            inside=1,
            trial=trial,
        )
    touched = world.step(torch.zeros(trials, 2, dtype=torch.float64), torch.tensor(70))
    assert touched["food"].all()
    assert not touched["food_container"].any()
    assert (world.touches == torch.tensor([1, 0, 0])).all()
    assert (world.inside == -1).all()
    assert (containers(world)[:, 0] == double(100.0, 50.0)).all()
    assert (containers(world)[:, 2] == double(200.0, 200.0)).all()
    assert (items(world)[:, 0] == double(99.0, 50.0)).all()
    distance = offset(containers(world)[:, 1], items(world)[:, 1], 300.0).norm(dim=1)
    assert float(distance.max()) < 14.0 + 1e-9
    assert 7.0 < float(distance.median()) < 12.5
    assert len(containers(world)[:, 1].unique(dim=0)) == trials
    assert float((containers(world)[:, 1] - double(50.0, 60.0)).abs().min()) > 0.0


def test_entering_and_taking_can_happen_in_one_tick() -> None:
    world = make_world(food_containers=1)
    place(world, (36.5, 50.0), 0.0, [[38.0, 50.0]], [[50.0, 50.0]])
    touched = world.step(STILL, NOW)
    assert [bool(touched[name]) for name in world.kinds.names] == [True, True, False]
    assert world.touches.tolist() == [[1, 1, 0]]
    assert world.inside.tolist() == [-1]


def test_a_world_starts_with_every_item_in_its_container() -> None:
    world = make_world(trials=20, free_items=3, food_containers=4, empty_containers=2)
    assert containers(world).shape == (20, 6, 2)
    distance = offset(containers(world)[:, :4], items(world)[:, 3:], 300.0).norm(dim=2)
    assert float(distance.max()) < 14.0 + 1e-9
    for tensor in (world.position, items(world), containers(world)):
        assert bool(((tensor >= 0) & (tensor < 300)).all())
    assert bool((world.inside == -1).all())


def touch(world: World, kind: str, time: int = 700) -> None:
    """Put the robot on an object of that kind, and let it touch that."""
    world.position.copy_(world.places[:, int(world.kinds.index(kind)[0])])
    world.inside.fill_(-1)
    assert bool(world.step(STILL, torch.tensor(time))[kind].all())


@pytest.mark.parametrize(("poison_from", "signs"), [(None, [1, 1, 1]), (1.0, [1, -1, -1]), (0.0, [-1, -1, -1])])
def test_food_is_poison_from_its_time_on(poison_from: float | None, signs: list[int]) -> None:
    for time, sign in zip((999, 1000, 5000), signs, strict=True):
        world = make_world(free_items=1, poison_from=poison_from)
        assert world.value(torch.tensor(time)).tolist() == [sign, 1, 1]
        touch(world, "food", time)
        assert world.sign.tolist() == [sign]


@pytest.mark.parametrize(
    ("poison_from", "signs"),
    [(None, [1, 1, -1, -1, 1, -1]), (0.5, [1, -1, -1, -1, 1, -1]), (0.0, [-1, -1, 1, 1, -1, 1])],
)
def test_food_turns_to_poison_and_back_as_often_as_is_said(poison_from: float | None, signs: list[int]) -> None:
    world = make_world(food=KindConfig(1, 2.4, poison_from=poison_from, turns_every=1.0))
    for time, sign in zip((0, 999, 1000, 1499, 2000, 3000), signs, strict=True):
        assert world.value(torch.tensor(time)).tolist() == [sign, 1, 1], time


def test_the_sign_is_that_of_what_was_touched_last() -> None:
    world = make_world(free_items=1, empty_containers=1, poison=KindConfig(1, 2.0, sign=-1))
    signs = []
    for kind in ("food", "poison", "food", "poison", "empty_container"):
        touch(world, kind)
        world.position.copy_(double(0.0, 0.0)[None])
        world.places.clamp_(min=20.0)
        world.step(STILL, NOW)
        signs.append(float(world.sign))
    assert signs == [1.0, -1.0, 1.0, -1.0, 1.0]
    assert [int(world.count(kind)) for kind in ("food", "poison", "empty_container", "nothing")] == [2, 2, 1, 0]


def test_of_food_and_poison_touched_at_once_poison_decides() -> None:
    world = make_world(free_items=1, poison=KindConfig(1, 2.0, sign=-1))
    place(world, (50.0, 50.0), 0.0, [[50.0, 51.0], [50.0, 49.0]])
    world.step(STILL, NOW)
    assert (world.touches.tolist(), world.sign.tolist()) == ([[1, 0, 0, 1]], [-1.0])


def test_what_needs_opening_is_entered_after_that_and_until_it_is_emptied() -> None:
    world = make_world(
        key=KindConfig(1, 2.0, opens=["chest"]), chest=KindConfig(1, 10.0, "entered", "food"), food_containers=1
    )
    for _ in range(2):
        world.places.copy_(double(*([50.0] * 2 + [100.0] * 2 + [200.0] * 2)).view(3, 2)[[0, 1, 2, 0, 2]][None])
        world.position.copy_(double(200.0, 200.0)[None])
        world.inside.fill_(-1)
        assert not any(bool(felt) for felt in world.step(STILL, NOW).values())  # locked, and what is in it is hidden
        touch(world, "key")
        world.places[:, world.kinds.index("chest")] = double(200.0, 200.0)
        world.places[:, 4] = double(205.0, 200.0)
        world.position.copy_(double(200.0, 200.0)[None])
        felt = world.step(STILL, NOW)
        assert [name for name, one in felt.items() if bool(one)] == ["chest"]
        world.position.copy_(double(204.0, 200.0)[None])
        felt = world.step(STILL, torch.tensor(700))
        assert [name for name, one in felt.items() if bool(one)] == ["food"]
        assert world.inside.tolist() == [-1]
        assert not world.unlocked.any()


def test_what_does_not_hide_lets_see_out_and_in() -> None:
    world = make_world(free_items=1, bush=KindConfig(1, 10.0, "entered", "food", hides=False))
    place(world, (50.0, 50.0), 0.0, [[58.0, 50.0], [55.0, 51.0]], [[50.0, 50.0]], inside=0)
    assert world.sense()["food"][0].tolist() == pytest.approx([1 - (math.hypot(5.0, 1.0) - 2.4) / 30, 0.0])
    place(world, (65.0, 50.0), math.pi, [[90.0, 90.0], [55.0, 51.0]], [[50.0, 50.0]])
    assert world.sense()["food"][0].tolist() == pytest.approx([0.0, 1 - (math.hypot(10.0, 1.0) - 2.4) / 30])
    place(world, (55.0, 50.0), 0.0, [[90.0, 90.0], [55.0, 51.0]], [[50.0, 50.0]], inside=0)
    world.step(STILL, NOW)
    assert (int(world.count("food")), world.inside.tolist()) == (1, [-1])


def test_a_sensor_of_several_kinds_sees_the_one_that_begins_nearest() -> None:
    world = make_world(rock=KindConfig(1, 9.0), pebble=KindConfig(1, 1.0))
    world.config.ranges["food"].sees = ["rock", "pebble"]
    world = World(world.draws, world.config, 70)
    place(world, (50.0, 50.0), 0.0, [[65.0, 55.0], [60.0, 45.0]])
    assert world.sense()["food"][0].tolist() == pytest.approx([1 - (math.hypot(15.0, 5.0) - 9.0) / 30, 0.0])


SITUATIONS = {  # position, heading, free items, food items, food containers, empty container, inside; touches
    "nothing near": ((50, 50), 1.0, (200, 200), (105, 100), (250, 250), -1, (0, 0, 0)),
    "free item": ((50, 50), 0.0, (53, 50), (105, 100), (250, 250), -1, (1, 0, 0)),
    "free item over the corner": ((299, 299), 0.7, (1.5, 1.5), (105, 100), (250, 250), -1, (1, 0, 0)),
    "free item just too far": ((50, 50), 0.0, (54.4, 50), (105, 100), (250, 250), -1, (0, 0, 0)),
    "enters a food container": ((85, 100), 0.0, (200, 200), (105, 100), (250, 250), -1, (0, 1, 0)),
    "is inside one": ((95, 100), 0.0, (97, 100), (105, 100), (250, 250), 0, (0, 0, 0)),
    "takes its food": ((103, 100), 0.5, (104, 100), (105, 100), (250, 250), 0, (1, 0, 0)),
    "enters and takes": ((85, 100), 0.0, (200, 200), (88, 100), (250, 250), -1, (1, 1, 0)),
    "passes its food outside": ((83, 100), 1.57, (200, 200), (86.5, 100), (250, 250), -1, (0, 0, 0)),
    "leaves a food container": ((113.5, 100), 0.0, (200, 200), (105, 100), (250, 250), 0, (0, 0, 0)),
    "enters an empty container": ((235, 250), 0.0, (200, 200), (105, 100), (250, 250), -1, (0, 0, 1)),
    "empty container over the edge": ((290, 50), 0.0, (200, 200), (105, 100), (2, 52), -1, (0, 0, 1)),
    "overlapping containers": ((107, 100), 0.0, (200, 200), (95, 100), (118, 100), 0, (0, 0, 0)),
    "changes containers": ((113.5, 100), 0.0, (200, 200), (95, 100), (118, 100), 0, (0, 0, 1)),
    "container and food on the right": ((50, 100), 0.2, (60, 95), (100, 96), (250, 250), -1, (0, 0, 0)),
    "food behind": ((50, 100), 3.0, (60, 95), (100, 96), (40, 130), -1, (0, 0, 0)),
}
FOOD_CONTAINERS = [[100.0, 100.0], [150.0, 260.0]]


def situations() -> Simulation:
    """A simulation with one trial for each of the situations; 1 free item, 2 food and 1 empty container."""
    simulation = make_simulation(
        "+experiment=dual_learning",
        f"trials={len(SITUATIONS)}",
        "seconds=1",
        "world.kinds.food.count=1",
        "world.kinds.food_container.count=2",
        "world.kinds.empty_container.count=1",
        "seed=3",
    )
    for trial, (position, heading, free, food, empty, inside, _) in enumerate(SITUATIONS.values()):
        place(
            simulation.situation.world,
            position,
            heading,
            [free, food, (152.0, 255.0)],
            [*FOOD_CONTAINERS, empty],
            inside,
            trial,
        )
    return simulation


@pytest.mark.parametrize("engine", ENGINES)
def test_whole_ticks_touch_what_the_situation_says(engine: str) -> None:
    simulation = situations()
    simulation.run(make_engine(engine, "cpu", 1), 1)
    for trial, (name, situation) in enumerate(SITUATIONS.items()):
        assert tuple(simulation.situation.world.touches[trial].tolist()) == situation[-1], name


@pytest.mark.parametrize("ticks", [1, 2])
def test_engines_agree_on_whole_ticks(ticks: int) -> None:
    """World and network after the tick; the second tick shows what touches and sensors did."""
    both = [situations() for _ in ENGINES]
    rasters = []
    for engine, simulation in zip(ENGINES, both, strict=True):
        raster = torch.zeros(70 * ticks, simulation.trials, simulation.network.size, dtype=torch.bool)
        simulation.run(make_engine(engine, "cpu", 1), ticks, raster)
        rasters.append(raster)
    assert torch.equal(*rasters)
    assert int(rasters[0].sum()) > 500
    reference, fused = (simulation.state_dict() for simulation in both)
    assert reference.keys() == fused.keys()
    for key, value in reference.items():
        assert torch.allclose(value.double(), fused[key].double(), rtol=0, atol=1e-9), key


def test_engines_agree_on_places_where_food_lies_anew() -> None:
    """Items and containers move to the same places in both, and only where food was taken."""
    both = [situations() for _ in ENGINES]
    before = items(both[0].situation.world).clone()
    for engine, simulation in zip(ENGINES, both, strict=True):
        simulation.run(make_engine(engine, "cpu", 1), 1)
    first, second = (simulation.situation.world for simulation in both)
    assert torch.allclose(items(first), items(second), rtol=0, atol=1e-9)
    assert torch.allclose(containers(first), containers(second), rtol=0, atol=1e-9)
    moved = (items(second) != before).any(2).sum(1).tolist()
    assert moved == [situation[-1][0] for situation in SITUATIONS.values()]


READINGS = (  # containers that land clear of each other where there is room for it
    "world.kinds.food_container.avoids=[robot,containers]",
    "world.kinds.food_container.contains=whole",
    "+world.kinds.chest.avoids=[containers]",
    "world.attempts=5",
    "world.overlap=nearest",
)


@pytest.mark.parametrize("readings", [(), READINGS], ids=["usual", "other"])
def test_engines_agree_in_a_world_of_many_kinds(readings: tuple[str, ...]) -> None:
    """Poison beside food, keys and what they open, bushes that do not hide, sensors of several kinds; all touched."""
    options = [
        "+experiment=dual_learning",
        "robot=benchmark",
        "trials=4",
        "world.side=160",
        "world.kinds.food.count=12",
        "world.kinds.food.poison_from=15",
        "world.kinds.food_container.count=3",
        "world.kinds.empty_container.count=2",
        "+world.kinds.poison={count: 6, radius: 3.0, sign: -1, turns_every: 4.0}",
        "+world.kinds.key={count: 9, radius: 4.0, opens: [chest]}",
        "+world.kinds.chest={count: 3, radius: 12.0, touched: entered, holds: food, speed: 0.7}",
        "+world.kinds.bush={count: 2, radius: 9.0, touched: entered, holds: poison, hides: false}",
        "world.ranges.food.sees=[food,key,poison]",
        "world.ranges.container.sees=[food_container,chest,bush]",
        "+coding.touches.poison=food_touch",
        "+coding.touches.chest=food_container_touch",
        *readings,
    ]
    both = [make_simulation(*options) for _ in ENGINES]
    for engine, simulation in zip(ENGINES, both, strict=True):
        simulation.run(make_engine(engine, "cpu", 1), 286)
    reference, fused = (simulation.state_dict() for simulation in both)
    touches = both[0].situation.world.touches.sum(0)
    assert bool((touches > 0).all()), dict(zip(both[0].situation.world.kinds.names, touches.tolist(), strict=True))
    for key, value in reference.items():
        within = 1e-6 if key.endswith((".v", ".u")) else 1e-9
        assert torch.allclose(value.double(), fused[key].double(), rtol=0, atol=within), key
