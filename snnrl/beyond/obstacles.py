"""Discs that stop the robot and hurt: how much less it runs into them, and what food that costs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from snnrl.beyond.course import Course, follow, interval
from snnrl.beyond.page import Page, draw, table
from snnrl.configuration.compose import compose_baselines
from snnrl.drawing.style import figure
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
    return Page(_table(courses, empty), _figure(courses))


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


def _figure(courses: Sequence[Course]) -> Figure:
    """Contact and food over time."""
    drawn, axes = figure(1, 2, width=7.2, height=3.2)
    for axis, kind, factor, label in (
        (axes[0], OBSTACLE, 60.0, "ticks of contact per min"),
        (axes[1], FOOD, 1.0, "food, items/s"),
    ):
        for course in courses:
            draw(axis, course.agent, course.time, factor * course.touches[kind] / course.every)
        axis.set(xlabel="time, s", ylabel=label, xlim=(0, None), ylim=(0, None))
    drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(AGENTS))
    return drawn
