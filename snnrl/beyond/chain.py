"""Chains of one, two and three steps to food: how many robots learn them, how soon, and what moving dopamine adds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from snnrl.beyond.course import Course, first_time, follow, interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.compose import compose_baselines
from snnrl.drawing import style
from snnrl.drawing.style import figure, legend, multiples, styled
from snnrl.intervals import wilson

INERT = "world.kinds.key.opens=[]"
CHAINS: dict[str, tuple[str, ...]] = {  # of world/chain, whose keys are there in all three
    "food": (INERT, "world.kinds.food.count=20", "world.kinds.food_container.count=0"),
    "container, food": (INERT,),
    "key, container, food": (),
}
WIRED = "benchmark"
TO_KEYS = "+robot.weights.key_attraction=${network.plasticity.weight_max}"  # of the wired robot, where keys open
AGENTS = (WIRED, "learning", "no_moving_dopamine", "fixed_dopamine", "sarsa_lambda", "random_walk")
SECONDS = 5000.0
EVERY = 50.0  # s
WINDOW = 6  # spans
LEARNT = 0.5  # part of what the wired robot collects
TUNED = ("sarsa_lambda.bins=2",)  # as in snnrl.beyond.changing_world

Courses = dict[str, dict[str, Course]]  # by chain and agent


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run all agents in all worlds; `part` of the time, for a trial."""
    options, courses = compose_baselines(*TUNED), {}
    for chain, changed in CHAINS.items():
        world = ("+experiment=chain", f"seconds={part * SECONDS:g}", *changed, *overrides)
        wired = () if INERT in changed else (TO_KEYS,)
        courses[chain] = {
            agent: follow(agent, EVERY, options, *world, *(wired if agent == WIRED else ())) for agent in AGENTS
        }
    return Page(_table(courses), figure_of(courses))


def late(course: Course) -> np.ndarray:
    """Food per s in the last WINDOW, [B]."""
    return course.rate("food")[-WINDOW:].mean(0)


def learning_time(course: Course, wired: Course) -> np.ndarray:
    """When (s) the food per s over WINDOW has first been LEARNT of what a wired robot collects; [B], nan if never."""
    wanted = LEARNT * wired.rate("food").mean()
    return first_time(course.rate("food").T, course.every, WINDOW, wanted)


def _table(courses: Courses) -> str:
    head = ("steps", "agent", "late food per s [95 %]", "learnt [95 %]", "s until then [95 %]")
    synapses = {"container to dopamine, mV": "food_container_dopamine", "key to dopamine, mV": "key_dopamine"}
    rows = []
    for chain, ran in courses.items():
        for agent, course in ran.items():
            taken = learning_time(course, ran[WIRED])
            share = float((~np.isnan(taken)).mean())
            low, high = wilson(share, len(taken))
            rows.append(
                (
                    chain,
                    agent.replace("_", " "),
                    interval(late(course), 3),
                    f"{share:.0%} [{low:.0%}, {high:.0%}]",
                    interval(np.where(np.isnan(taken), course.time[-1], taken), 0),
                    *(f"{course.weights[role].mean():.2f}" if course.weights else "" for role in synapses.values()),
                )
            )
    return table((*head, *synapses), rows)


@styled
def figure_of(courses: Courses) -> Figure:
    """Food per s over time, a row for each chain and a panel for each agent."""
    agents = len(next(iter(courses.values())))
    drawn, axes = figure(len(courses), agents, width=9.6, height=5.6, sharex=True, sharey="row", squeeze=False)
    for row, (chain, ran) in zip(axes, courses.items(), strict=True):
        multiples(row, {agent: (course.time, course.rate("food")) for agent, course in ran.items()})
        row[0].set(ylabel=f"{chain.capitalize()}\nRate (items/s)", xlim=(0, None), ylim=(0, None))
    for axis in axes[1:].flat:
        axis.set(title="")
    for axis in axes[-1]:
        axis.set(xlabel=style.TIME)
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn
