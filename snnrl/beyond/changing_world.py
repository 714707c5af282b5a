"""Food and poison change places again and again: how soon an agent takes the one and leaves the other again.

One life in one world for each trial: what is learnt, is learnt from the one robot's own touches. But for `MANY`, beside
them: one agent that lives in the worlds of all trials at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from snnrl.beyond.course import Course, first_time, follow, interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.compose import compose_baselines
from snnrl.drawing.style import figure, legend, multiples, styled

PERIODS = (200.0, 500.0, 1000.0)  # s from one swap to the next
SWAPS = 20
AGENTS = ("learning", "no_hunger", "sarsa_lambda", "q_learning", "reinforce")
MANY, SHARED = "reinforce, many worlds", ("reinforce.shared=true",)
EVERY = 10.0  # s
WINDOW = 5  # spans over which the reward is averaged
REACHED = 0.25  # 1/s; a random walk's mean is 0, with a standard deviation of 0.07 over the window
LAST = 5  # swaps
DRIFT = {"food": 500.0, "poison": 700.0}  # s from one turn of a kind to its next: all that can be, within the length
LENGTH = 7000.0  # s
# The best of those tried in this world, in 20 trials of 2500 s from seed 3,000,000 on; the robots' values are their own
TUNED = ("sarsa_lambda.bins=2", "q_learning.bins=2", "reinforce.bins=1")


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run all agents at all periods; `part` of the swaps, for a trial."""
    options, many = compose_baselines(*TUNED), compose_baselines(*TUNED, *SHARED)

    def follow_all(*changes: str) -> list[Course]:
        world = ("+experiment=changing_world", *changes, *overrides)
        lives = [follow(agent, EVERY, options, *world) for agent in AGENTS]
        return [*lives, replace(follow("reinforce", EVERY, many, *world), agent=MANY)]

    courses = {}
    for period in PERIODS:
        length = (1 + max(1, round(part * SWAPS))) * period
        courses[period] = follow_all(f"world.kinds.food.turns_every={period}", f"seconds={length}")
    turns = [f"world.kinds.{kind}.turns_every={period:g}" for kind, period in DRIFT.items()]
    drift = follow_all(*turns, f"seconds={part * LENGTH:g}")
    return Page(f"{_table(courses)}\n{drift_table(drift)}", figure_of(courses))


def since_swap(course: Course, period: float) -> np.ndarray:
    """Reward per s from food and poison, [phases, spans of a phase, B]; the first phase is that before any swap."""
    reward = course.rate("food", "poison")
    spans = round(period / course.every)
    return reward[: len(reward) // spans * spans].reshape(-1, spans, reward.shape[1])


def relearning(course: Course, period: float) -> np.ndarray:
    """When in each phase (s) the mean reward over the last WINDOW has first REACHED; [phases, B], nan where never."""
    return first_time(since_swap(course, period).swapaxes(1, 2), course.every, WINDOW, REACHED)


def drift_table(courses: Sequence[Course]) -> str:
    """Reward per s, of all time and of that in which so many of the two kinds were good."""
    head = ("as kinds drift", "reward per s [95 %]", "while both are good", "while one is", "while none is")
    rows = []
    for course in courses:
        reward = course.rate(*DRIFT)
        good = sum((course.signs[kind] > 0).astype(int) for kind in DRIFT)
        by_good = (reward[good == count] for count in (2, 1, 0))
        cells = (interval(part.mean(0), 2) if len(part) else "" for part in (reward, *by_good))
        rows.append((course.agent.replace("_", " "), *cells))
    return table(head, rows)


def _table(courses: dict[float, list[Course]]) -> str:
    head = (
        "swap every",
        "agent",
        "reward per s [95 %]",
        "swaps after which it re-learnt [95 %]",
        "s until then [95 %]",
        f"of the last {LAST} swaps",
    )
    rows = []
    for period, ran in courses.items():
        for course in ran:
            taken = relearning(course, period)[1:]
            lasted = np.where(np.isnan(taken), period, taken)
            rows.append(
                (
                    f"{period:g} s",
                    course.agent.replace("_", " "),
                    interval(since_swap(course, period).mean((0, 1)), 2),
                    interval(100 * (~np.isnan(taken)).mean(0), 0),
                    interval(lasted.mean(0), 0),
                    interval(lasted[-LAST:].mean(0), 0),
                )
            )
    return table(head, rows)


@styled
def figure_of(courses: dict[float, list[Course]]) -> Figure:
    """Of each period, a row of the reward since the swap, mean over all swaps, and one of how long re-learning took."""
    agents = len(next(iter(courses.values())))
    drawn, axes = figure(2 * len(courses), agents, 9.6, 3.4 * len(courses), sharex="row", sharey="row", squeeze=False)
    for k, (period, ran) in enumerate(courses.items()):
        rewards, taken = {}, {}
        for course in ran:
            rate, lasted = since_swap(course, period)[1:].mean(0), relearning(course, period)[1:]
            rewards[course.agent] = course.every * (np.arange(len(rate)) + 0.5), rate
            taken[course.agent] = np.arange(1, len(lasted) + 1), np.where(np.isnan(lasted), period, lasted)
        for row, shown in ((axes[2 * k], rewards), (axes[2 * k + 1], taken)):
            multiples(row, shown)
        for above, below in zip(axes[2 * k], axes[2 * k + 1], strict=True):
            above.axhline(0.0, color="black", linewidth=0.6)
            above.set(xlabel="Time since\nthe swap (s)", xlim=(0, period))
            below.set(title="", xlabel="Swap", ylim=(0, 1.05 * period))
        axes[2 * k][0].set_ylabel(f"Swap every {period:g} s\nReward (items/s)")
        axes[2 * k + 1][0].set_ylabel("Until it re-learnt (s)")
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn
