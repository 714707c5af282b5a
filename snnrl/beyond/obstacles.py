"""Discs that stop the robot and hurt: how much less it runs into them, and what food that costs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from snnrl.beyond.course import Course, follow, interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.compose import compose_baselines
from snnrl.drawing import style
from snnrl.drawing.style import figure, legend, multiples, styled
from snnrl.schema import FOOD

OBSTACLE = "obstacle"
AGENTS = ("learning", "no_pain", "random_walk")
SECONDS = 1000.0
EVERY = 50.0  # s
EARLY = 100.0  # s
LATE = 0.2  # the last part of the time, in which what has been learnt shows


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run all agents, and the one that learns without obstacles; `part` of the time, for a trial."""
    world = ("+experiment=obstacles", f"seconds={part * SECONDS:g}", *overrides)
    options = compose_baselines()
    courses = [follow(agent, EVERY, options, *world) for agent in AGENTS]
    empty = follow("learning", EVERY, options, *world, f"world.kinds.{OBSTACLE}.count=0")
    return Page(_table(courses, empty), figure_of(courses))


def early(course: Course, kind: str) -> np.ndarray:
    """Touches of a kind per s at the beginning, [B]."""
    return _rate(course, kind, slice(None, max(1, round(EARLY / course.every))))


def late(course: Course, kind: str) -> np.ndarray:
    """Touches of a kind per s at the end, [B]."""
    return _rate(course, kind, slice(-max(1, round(LATE * len(course.time))), None))


def _rate(course: Course, kind: str, spans: slice) -> np.ndarray:
    return np.asarray(course.touches[kind][spans].mean(0) / course.every)


def _table(courses: Sequence[Course], empty: Course) -> str:
    unhurt = next(late(course, OBSTACLE).mean() for course in courses if course.agent == "no_pain")
    rows: list[tuple[str, ...]] = [
        (
            course.agent.replace("_", " "),
            interval(60 * early(course, OBSTACLE), 1),
            interval(60 * late(course, OBSTACLE), 1),
            f"{late(course, OBSTACLE).mean() / early(course, OBSTACLE).mean():.2f}",
            f"{late(course, OBSTACLE).mean() / unhurt:.2f}",
            interval(late(course, FOOD), 3),
            f"{late(course, FOOD).mean() / late(empty, FOOD).mean():.2f}",
        )
        for course in courses
    ]
    rows.append(("learning, no obstacles", *["-"] * 4, interval(late(empty, FOOD), 3), "1.00"))
    times = ("early ticks of contact per min [95 %]", "late ones [95 %]", "late of early", "of no pain's")
    return table(("agent", *times, "late food per s [95 %]", "of that without obstacles"), rows)


@styled
def figure_of(courses: Sequence[Course]) -> Figure:
    """Contact and food over time, a panel for each agent."""
    drawn, axes = figure(2, len(courses), width=7.2, height=4.2, sharex=True, sharey="row", squeeze=False)
    labels = {OBSTACLE: (60.0, "Contact (ticks/min)"), FOOD: (1.0, style.RATE)}
    for row, (kind, (factor, label)) in zip(axes, labels.items(), strict=True):
        multiples(row, {c.agent: (c.time, factor * c.touches[kind] / c.every) for c in courses})
        row[0].set(ylabel=label, xlim=(0, courses[0].time[-1]), ylim=(0, None))
    for axis in axes[1]:
        axis.set(title="", xlabel=style.TIME)
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn
