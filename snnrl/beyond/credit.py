"""What made the weights: how much of each came from food, from a container's touch, from hunger, and from the bounds.

Means over the synapses with a role, in mV, as time goes on; the parts add up to the change of the weight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from snnrl.beyond.account import Account
from snnrl.beyond.booking import PARTS, ROUNDING
from snnrl.beyond.course import interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.drawing import style
from snnrl.drawing.palette import CREDIT
from snnrl.drawing.style import figure, legend, spoken, styled
from snnrl.engines import make_engine
from snnrl.intervals import student_half
from snnrl.running.schedule import ticks_of
from snnrl.schema import Config

WORLDS = {"food": ("food_attraction", "learning"), "food in containers": ("dual_learning", "learning")}
SAMPLES = 100  # of a run


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run both worlds; `part` of the published length, for a trial."""
    found = {
        world: course(compose(f"+experiment={experiment}", f"robot={robot}", *overrides), part)
        for world, (experiment, robot) in WORLDS.items()
    }
    return Page(_table(found), figure_of(found))


def course(config: Config, part: float = 1.0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """When there are samples, [T], s, and `Account.by_role` at each, [T, B, 7] by role, over a part of a run.

    Raises:
        ConfigError: the robot does not learn in a way that can be accounted for.
    """
    simulation, engine = build(config), make_engine(config.engine, config.device, config.threads)
    account, ticks = Account(simulation), ticks_of(part * config.seconds, simulation.tick)
    marks = np.unique(np.linspace(0, ticks, SAMPLES + 1).round().astype(int))
    samples = []
    for ticks in np.diff(marks, prepend=0):
        account.run(simulation, engine, int(ticks))
        samples.append(account.by_role())
    roles = {role: np.stack([sample[role] for sample in samples]) for role in samples[0]}
    return marks * simulation.tick / 1000.0, roles


def _table(found: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]) -> str:
    rows = [
        (world, role.replace("_", " "), *(interval(values, 2) for values in (parts[-1].sum(1), *parts[-1].T)))
        for world, (_, roles) in found.items()
        for role, parts in roles.items()
    ]
    return table(("world", "synapses", "change, mV [95 %]", *PARTS), rows)


@styled
def figure_of(found: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]) -> Figure:
    """A row for each world, a column for each role."""
    drawn, axes = figure(len(found), max(len(roles) for _, roles in found.values()), 13.0, 5.6, squeeze=False)
    for row, (world, (time, roles)) in zip(axes, found.items(), strict=True):
        for axis in row[len(roles) :]:
            axis.set_axis_off()
        for axis, (role, parts) in zip(row, roles.items(), strict=False):
            draw(axis, time, parts)
            axis.set(title=spoken(role).replace(" ", "\n", 1), xlabel=style.TIME, xlim=(0, time[-1]))
        row[0].set_ylabel(f"{world.capitalize()}\nCredit (mV)")
    legend(drawn, loc="outside lower center", ncols=5)
    return drawn


def draw(axis: Axes, time: np.ndarray, parts: np.ndarray) -> None:
    """Stack the parts, [T, B, 7]: their means over trials, what raises from 0 upwards and what lowers downwards.

    The line is what they add up to, with its interval.
    """
    for sign in (1.0, -1.0):
        edge = np.zeros(len(time))
        for k, colour in enumerate(CREDIT):
            before, edge = edge, edge + sign * (sign * parts[..., k].mean(1)).clip(0.0)
            axis.fill_between(time, before, edge, color=colour, linewidth=0, label=PARTS[k] if sign > 0 else None)
    change, trials = parts.sum(2), parts.shape[1]
    axis.plot(time, change.mean(1), color="black", label="change of the weight")
    if trials > 1:
        half = student_half(change.std(1, ddof=1), trials)
        low, high = change.mean(1) - half, change.mean(1) + half
        axis.fill_between(time, low, high, color="black", alpha=0.25, linewidth=0, label=style.INTERVAL)


assert len(CREDIT) == ROUNDING  # which is too small to be seen
