"""Chains of one, two and three steps to food: how many robots learn them, how soon, and what moving dopamine adds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from matplotlib.figure import Figure

from snnrl.beyond.course import Course, first_time, follow, interval
from snnrl.beyond.extinction import PULSE, evoked
from snnrl.beyond.page import Page, table
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose, compose_baselines
from snnrl.drawing import style
from snnrl.drawing.style import figure, legend, multiples, styled
from snnrl.engines import make_engine
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

GAPS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)  # s from one link of the chain to the next, in open loop
LINKS = ("key_touch", "food_container_touch", "food_touch")
PRESENTED, PAUSE, REST = 200, 3000, 1000  # chains; ms between two of them; ms of rest at a time
ANSWERS = 0.1  # spikes of a dopaminergic neuron that are an answer

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
    answers = {gap: presented(gap, max(1, round(part * PRESENTED)), overrides) for gap in GAPS}
    return Page(f"{_table(courses)}\n{_gaps_table(answers)}", figure_of(courses))


def presented(gap: float, times: int, overrides: Sequence[str]) -> dict[str, np.ndarray]:
    """Spikes of a dopaminergic neuron, [B], that a link evokes after chains with such a gap, in open loop, by link."""
    config = compose("+experiment=chain", *overrides)
    network, engine = build(config).network, make_engine(config.engine, config.device, config.threads)
    still = torch.zeros(REST, network.trials, network.size, dtype=network.dtype)
    for _ in range(times):
        for link in LINKS:
            pulse = still[:1].clone()
            pulse[:, :, network.groups[link].span] = PULSE
            engine.run_network(network, pulse)
            left = (PAUSE if link == LINKS[-1] else round(1000 * gap)) - 1
            for start in range(0, left, REST):
                engine.run_network(network, still[: min(REST, left - start)])
    return {link: evoked(network, link).double().numpy() for link in LINKS[:-1]}


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


def _gaps_table(answers: dict[float, dict[str, np.ndarray]]) -> str:
    """What moved how far, by the time from link to link."""
    names = [link.removesuffix("_touch").replace("_", " ") for link in LINKS[:-1]]
    head = ["s from link to link"]
    for name in reversed(names):
        head += [f"answer to the {name}, spikes [95 %]", "trials that have one"]
    rows = []
    for gap, found in answers.items():
        row = [f"{gap:g}"]
        for link in reversed(LINKS[:-1]):
            row += [interval(found[link], 2), f"{(found[link] > ANSWERS).sum()} of {len(found[link])}"]
        rows.append(row)
    return table(head, rows)


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
