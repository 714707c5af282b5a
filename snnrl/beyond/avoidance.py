"""Poison that hurts: how much less of it a robot with a second modulator touches than one that walks at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from snnrl.beyond.course import Course, follow, interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.compose import compose_baselines
from snnrl.drawing import style
from snnrl.drawing.style import figure, legend, multiples, styled

AGENTS = ("learning", "no_pain", "sarsa_lambda", "random_walk")
THESIS = ("network=food_poison", "coding.touches.poison=food_touch")  # poison lowers dopamine, and there is no pain
PLAIN = "thesis's network"
SECONDS = 2000.0
EVERY = 50.0  # s
LATE = 0.5  # the last part of the time, in which what has been learnt shows
TUNED = ("sarsa_lambda.bins=2",)  # as in snnrl.beyond.changing_world


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run all agents; `part` of the time, for a trial."""
    world = ("+experiment=avoidance", f"seconds={part * SECONDS:g}", *overrides)
    options = compose_baselines(*TUNED)
    courses = [follow(agent, EVERY, options, *world) for agent in AGENTS]
    courses.insert(1, replace(follow("learning", EVERY, options, *world, *THESIS), agent=PLAIN))
    return Page(_table(courses), figure_of(courses))


def late(course: Course, kind: str) -> np.ndarray:
    """Touches of a kind per s in the last part, [B]."""
    spans = course.touches[kind]
    return np.asarray(spans[-max(1, round(LATE * len(spans))) :].mean(0) / course.every)


def _table(courses: Sequence[Course]) -> str:
    walk = next(course for course in courses if course.agent == "random_walk")
    rows = [
        (
            course.agent.replace("_", " "),
            *(interval(late(course, kind), 3) for kind in ("food", "poison")),
            interval(late(course, "food") - late(course, "poison"), 3),
            f"{late(course, 'poison').mean() / late(walk, 'poison').mean():.2f}",
        )
        for course in courses
    ]
    of = ("reward per s [95 %]", "of a random walk's poison")
    return table(("agent", "late food per s [95 %]", "late poison per s [95 %]", *of), rows)


@styled
def figure_of(courses: Sequence[Course]) -> Figure:
    """Food and poison touched per s over time, a panel for each agent."""
    drawn, axes = figure(2, len(courses), width=7.2, height=4.2, sharex=True, sharey="row", squeeze=False)
    for row, kind in zip(axes, ("food", "poison"), strict=True):
        multiples(row, {course.agent: (course.time, course.touches[kind] / course.every) for course in courses})
        row[0].set(ylabel=f"{kind.capitalize()} touched (items/s)", xlim=(0, courses[0].time[-1]), ylim=(0, None))
    for axis in axes[1]:
        axis.set(title="", xlabel=style.TIME)
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn
