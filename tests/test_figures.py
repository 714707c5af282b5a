"""All figures that the package draws, on small data: axes, names and legends by one convention, and one way to save."""

from __future__ import annotations

from pathlib import Path

import film
import matplotlib as mpl
import numpy as np
import pytest
import scale
import torch
from helpers import make_simulation
from labels import faults
from matplotlib.figure import Figure

from snnrl.agents.baselines import Result, figure_of
from snnrl.beyond import avoidance, chain, changing_world, extinction, regimes
from snnrl.beyond.course import Course
from snnrl.drawing import palette, pictures, style, task_figures
from snnrl.drawing.charts import rewards
from snnrl.engines import make_engine

mpl.use("Agg")
TIME = np.arange(1.0, 41.0)
RATE = np.linspace(0.0, 1.0, 120).reshape(40, 3)


def course(agent: str) -> Course:
    touches = {kind: np.ones((40, 3), int) for kind in ("food", "poison")}
    return Course(agent, 10.0, touches, {"food": np.ones(40), "poison": -np.ones(40)})


def result(agent: str, task: str) -> Result:
    return Result(task, agent, TIME, np.ones((40, 3), int), TIME > 20)


def life() -> dict[str, np.ndarray]:
    return {"time": TIME, "response": RATE, "lead": RATE, "visits": RATE}


def task_series() -> dict[str, np.ndarray]:
    weight = np.linspace(0.1, 3.9, 120).reshape(40, 3)
    counted = np.arange(40 * 3 * 4).reshape(40, 3, 4)
    of_synapses = {"chosen_weight": weight, "max_weight": weight, "mean_weight": weight, "rewards": counted[..., 0]}
    histogram = {"edges": np.linspace(0.0, 4.0, 6), "histogram": np.full((3, 5), 7)}
    return {"time": TIME, "presented": counted, "response": 2 * counted, **of_synapses, **histogram}


@pytest.fixture(scope="module")
def figures() -> dict[str, Figure]:
    """Of everything but the thesis and replays, which have theirs in test_reproduce.py and test_replay.py."""
    stages = dict.fromkeys(("first", "trained", "omitted"), torch.rand(extinction.LENGTH, 2))
    points = np.ones((2, 3))
    grid = regimes.Regimes(np.array([1.0, 2.0]), points, np.array([1.0, 1.5]), 0.5 * points)
    curves = film.Curves([0.0, 1.0], [0, 1], [0.0, 1.0], [0.0, 0.5])
    agents = ("learning", "no_pain", "sarsa_lambda", "random_walk")
    return {
        "avoidance": avoidance.figure_of([course(agent) for agent in avoidance.AGENTS]),
        "chain": chain.figure_of({name: {agent: course(agent) for agent in chain.AGENTS} for name in chain.CHAINS}),
        "changing_world": changing_world.figure_of({100.0: [course(agent) for agent in agents]}),
        "extinction": extinction.draw(dict.fromkeys(["predicting"], stages), {"predicting": life()}, 10.0, 20.0),
        "regimes": regimes.figure_of({"food": grid, "food in containers": grid}),
        "baselines": figure_of(
            [result(agent, task) for task in ("food", "food_poison") for agent in ("spiking", "q_learning")]
        ),
        "reinforcement": task_figures.draw_reinforcement(task_series()),
        "conditioning": task_figures.draw_conditioning(task_series(), 1, 50),
        "film": film.draw(curves, 100.0),
    }


@pytest.mark.parametrize(
    "name",
    [
        "avoidance",
        "chain",
        "changing_world",
        "extinction",
        "regimes",
        "baselines",
        "reinforcement",
        "conditioning",
        "film",
    ],
)
def test_a_figure_keeps_the_convention(figures: dict[str, Figure], name: str) -> None:
    assert faults(figures[name]) == []


def test_what_runs_show_of_themselves_keeps_it_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = make_simulation("+experiment=dual_learning", "trials=1")
    fired = torch.zeros(140, 1, simulation.network.size, dtype=torch.bool)
    make_engine("fused", "cpu", 1).run_network(
        simulation.network, torch.zeros(fired.shape, dtype=torch.float64), None, fired
    )
    world, roles = simulation.situation.world, [p for p in simulation.network.projections.values() if p.role]
    weights = pictures.weight_matrix(simulation.network, roles)
    assert weights is not None
    most = max(projection.rule.weight_max for projection in roles if projection.rule)
    assert weights.axes[0].images[0].get_clim() == (0.0, most)  # in every picture of a run
    shown = [
        pictures.arena(world, RATE[:, :2] * 50),
        pictures.spike_raster(simulation.network, fired[:, 0].numpy(), 0.0),
    ]
    assert [faults(drawn) for drawn in (*shown, weights)] == [[], [], []]
    saved: list[Figure] = []
    monkeypatch.setattr(scale, "save", lambda drawn, *_: saved.append(drawn))
    size = scale.Size("hours", 1.0, 1, 3600.0)
    scale.draw([scale.Cost(size, 0.0, wall, 0.0, wall, 0.0, 0.0) for wall in (1.0, 2.0)], tmp_path / "scale.png")
    assert faults(saved[0]) == []


def test_a_fault_is_found() -> None:
    drawn, (left, right) = style.figure(1, 2)
    left.set(xlabel="time (s)", ylabel="Weight, mV")
    right.set(xlabel="Time (s)", title="food_container")
    style.band(right, TIME, RATE, palette.FOOD, "rate")
    assert set(faults(drawn)) == {"time (s)", "Weight, mV", "food_container", style.INTERVAL, style.SPREAD}


def test_robots_have_one_colour_each_and_it_is_in_the_palette() -> None:
    root = Path(style.__file__).parents[1]
    names = [path.stem for path in (root.parent / "conf" / "robot").glob("*.yaml")]
    assert set(names) <= palette.ROBOTS.keys()
    for path in [*root.rglob("*.py"), *(root.parent / "tools").glob("*.py")]:
        if path.name != "palette.py":
            assert not any(colour in path.read_text() for colour in palette.ROBOTS.values()), path


def test_a_figure_is_saved_as_bitmap_and_vector_the_same_each_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        drawn, axis = style.figure()
        style.band(axis, TIME, RATE, palette.FOOD, "rate")
        style.save(drawn, tmp_path / f"{name}.0")
    assert (tmp_path / "a.0.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (tmp_path / "a.0.svg").read_text()
    assert (tmp_path / "a.0.svg").read_bytes() == (tmp_path / "b.0.svg").read_bytes()


def test_a_panel_has_its_own_areas_and_the_means_of_the_others() -> None:
    _, axes = style.figure(1, 3)
    style.multiples(axes, {name: (TIME, RATE + k) for k, name in enumerate(("learning", "benchmark", "random_walk"))})
    for k, axis in enumerate(axes):
        assert [float(line.get_ydata()[0]) - RATE[0].mean() for line in axis.lines] == [*({0, 1, 2} - {k}), k]
        assert len(axis.collections) == 2


def test_rewards_are_between_the_sample_that_tells_of_them_and_the_one_before() -> None:
    axis = style.figure()[1]
    rewards(axis, np.array([1.0, 1.5, 2.5]), np.array([True, False, True]))
    spans = [tuple(np.unique(np.asarray(path.vertices)[:, 0])) for path in axis.collections[0].get_paths()]
    assert spans == [(0.5, 1.0), (1.5, 2.5)]
