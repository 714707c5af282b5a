"""Which sign dopamine's baseline should have, with pain beside it and without: leaving an orbit, eating, fleeing.

The thesis needs a negative baseline, hunger, to give up what does not work (4.1), and finds that it also raises
avoidance where there is nothing to avoid (4.3). No concentration is below zero, and so, it says, a transmitter of pain
might do what a negative one of dopamine does. Here hunger is a tonic level of either: of dopamine, below zero, or of
pain, above it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from matplotlib.figure import Figure

from snnrl.beyond.avoidance import THESIS, late
from snnrl.beyond.course import follow, interval
from snnrl.beyond.page import Page, table
from snnrl.body.world.geometry import escape_radius
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose, compose_baselines
from snnrl.drawing.palette import CYCLE
from snnrl.drawing.style import figure, styled
from snnrl.engines import make_engine
from snnrl.intervals import student, wilson
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD

SIGNS = {"negative": "learning", "zero": "no_hunger", "positive": "positive_baseline"}  # robots, by dopamine's baseline
MODELS: Mapping[str, tuple[str, ...]] = {"dopamine alone": THESIS, "poison hurts": ()}
VARIANTS: Mapping[str, tuple[str, tuple[str, ...]]] = {  # a robot, and overrides
    **{f"{model}, {sign}": (robot, options) for model, options in MODELS.items() for sign, robot in SIGNS.items()},
    "poison and hunger hurt, zero": ("hunger_hurts", ()),
}
ORBIT = (  # that of the thesis, in this robot's world
    "seconds=40",
    "world.kinds.poison.count=0",
    "world.kinds.food.count=1",
    "world.orbiting=true",
    "+robot.weights.food_attraction=${network.plasticity.weight_max}",
)
SECONDS, EVERY = 2000.0, 50.0


@dataclass(frozen=True)
class Outcome:
    """What the trials of one variant came to, [B] each.

    Attributes:
        escaped: bool, whether the robot left its orbit.
        food, poison: late touches per s, among both.
        avoidance: mean weight of what turns away from food at the end, mV.
    """

    escaped: np.ndarray
    food: np.ndarray
    poison: np.ndarray
    avoidance: np.ndarray


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run all variants; `part` of the time among food and poison, for a trial."""
    found = {name: _outcome(*variant, overrides, part) for name, variant in VARIANTS.items()}
    return Page(_table(found), figure_of(found))


def _outcome(robot: str, options: Sequence[str], overrides: Sequence[str], part: float) -> Outcome:
    world = ("+experiment=avoidance", *options, *overrides)
    course = follow(robot, EVERY, compose_baselines(), *world, f"seconds={part * SECONDS:g}")
    food, poison = (late(course, kind) for kind in (FOOD, "poison"))
    return Outcome(escaped(*world, f"robot={robot}", *ORBIT), food, poison, course.weights["food_avoidance"])


def escaped(*overrides: str) -> np.ndarray:
    """Whether each robot leaves the orbit that it begins on, or takes what it is round; bool [B]."""
    config = compose(*overrides)
    simulation, engine = build(config), make_engine(config.engine, config.device, config.threads)
    coding, world = config.body()
    limit = escape_radius(coding.slow, coding.fast, coding.tick / 1000, world.axle)
    left = torch.zeros(config.trials, dtype=torch.bool)
    for _ in range(ticks_of(config.seconds, coding.tick)):
        simulation.run(engine, 1)
        left |= (simulation.situation.world.nearest_item() > limit) | (simulation.situation.world.count(FOOD) > 0)
    return left.numpy()


def _table(found: Mapping[str, Outcome]) -> str:
    rows = []
    for name, ours in found.items():
        low, high = (100 * edge for edge in wilson(ours.escaped.mean(), len(ours.escaped)))
        rows.append(
            (
                *name.rsplit(", ", 1),
                f"{100 * ours.escaped.mean():.0f} % [{low:.0f}, {high:.0f}]",
                *(interval(values, 3) for values in (ours.food, ours.poison)),
                interval(ours.avoidance, 2),
            )
        )
    head = ("model", "dopamine's baseline", "leave the orbit [95 %]", "late food per s [95 %]")
    return table((*head, "late poison per s [95 %]", "food avoidance's mean weight, mV [95 %]"), rows)


@styled
def figure_of(found: Mapping[str, Outcome]) -> Figure:
    """A panel for each quantity, a row with its 95 % interval for each variant."""
    drawn, axes = figure(1, 4, width=9.6, height=2.8, sharey=True)
    models = list(dict.fromkeys(name.rsplit(", ", 1)[0] for name in found))
    for y, (name, ours) in enumerate(found.items()):
        colour = CYCLE[models.index(name.rsplit(", ", 1)[0])]
        n = len(ours.escaped)
        shares = [100 * share for share in (ours.escaped.mean(), *wilson(ours.escaped.mean(), n))]
        means = ([values.mean(), *student(values)] for values in (ours.food, ours.poison, ours.avoidance))
        for axis, (centre, low, high) in zip(axes, (shares, *means), strict=True):
            axis.errorbar(centre, y, xerr=[[centre - low], [high - centre]], fmt="o", color=colour, ms=4, capsize=2)
    labels = ("Leave the orbit (%)", "Food (items/s)", "Poison (items/s)", "Food avoidance, mean (mV)")
    for axis, label in zip(axes, labels, strict=True):
        axis.set(xlabel=label, xlim=(0, None))
    axes[0].set_yticks(range(len(found)), list(found))
    axes[0].set(xlim=(-3, 103), ylim=(len(found) - 0.5, -0.5))
    return drawn
