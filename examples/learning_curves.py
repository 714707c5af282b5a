"""How many steps in the world learning takes: the spiking robot, tables, and an off-the-shelf PPO.

    pip install "snnrl[rl,figures]"
    python examples/learning_curves.py [--page docs/learning_curves.md] [--steps 300000] [--lives 5] [--seeds 3]

One life in one world for all, PPO too; and PPO as it is meant to be used, in many worlds at once, whose steps add up.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import gymnasium
import numpy as np
import torch
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import snnrl.environments
from snnrl.agents.baselines import collect
from snnrl.beyond.page import Page, table
from snnrl.configuration.compose import compose, compose_baselines
from snnrl.drawing import palette, style
from snnrl.drawing.style import figure, legend, multiples, spoken, styled
from snnrl.intervals import student

gymnasium.register_envs(snnrl.environments)

TASKS = {"food attraction": "food_attraction", "food in containers": "dual_learning"}
AGENTS = ("spiking", "q_learning", "sarsa_lambda", "reinforce")
WIRED = "braitenberg"  # what needs no learning, as the measure
LIFE, MANY = "PPO, one life", "PPO, many worlds"
SPANS = 100  # into which a life is divided
EPISODE = 140  # s, of one of many worlds


@dataclass
class Curve:
    """What an agent collects: items per s in each of its worlds [T, B] in spans of so many environment steps."""

    agent: str
    steps: float
    rate: np.ndarray

    def reached(self, rate: float) -> np.ndarray:
        """The steps until each has collected at such a rate for a tenth of its spans, [B]; nan where it never has."""
        width = max(1, len(self.rate) // 10)
        sums = np.cumsum(np.pad(self.rate, ((1, 0), (0, 0))), 0)
        above = (sums[width:] - sums[:-width]) / width >= rate
        return np.where(above.any(0), (above.argmax(0) + width) * self.steps, np.nan)


class Rewards(BaseCallback):
    """Keeps the reward of each step of each world."""

    def __init__(self) -> None:
        super().__init__()
        self.kept: list[np.ndarray] = []

    def _on_step(self) -> bool:
        self.kept.append(self.locals["rewards"].copy())
        return True


def ppo(
    experiment: str, worlds: int, steps: int, seconds: float, seed: int, tick: float, overrides: list[str]
) -> np.ndarray:
    """PPO with Stable-Baselines3's own values: items per s, [SPANS], the mean over its worlds."""
    identifier = f"snnrl/{experiment.title().replace('_', '')}-v0"
    overrides = [*overrides, f"seconds={seconds}"]
    made = make_vec_env(lambda: gymnasium.make(identifier, overrides=overrides), worlds, seed=seed)
    rewards = Rewards()
    batch = 64 if worlds == 1 else 512
    PPO("MlpPolicy", made, n_steps=256, batch_size=batch, seed=seed, device="cpu").learn(steps, rewards)
    kept = np.stack(rewards.kept)[: steps // worlds].mean(1)
    return kept[: len(kept) // SPANS * SPANS].reshape(SPANS, -1).mean(1) / tick


def curves(experiment: str, arguments: argparse.Namespace) -> tuple[list[Curve], float]:
    """Of all agents, and the rate at which the wired one collects."""
    config = compose(f"+experiment={experiment}", f"trials={arguments.trials}", *arguments.override)
    options, tick = compose_baselines(f"samples={SPANS}"), config.body()[0].tick / 1000.0
    ticks = round(config.seconds / tick)
    wired = collect(experiment, WIRED, config, options).row()
    found = []
    for agent in AGENTS:
        result = collect(experiment, agent, config, options)
        found.append(Curve(agent, ticks / len(result.time), result.items / result.spans[:, None]))
    rest = tick, arguments.override
    lives = [ppo(experiment, 1, ticks, config.seconds + 1.0, seed, *rest) for seed in range(arguments.lives)]
    many = [ppo(experiment, arguments.worlds, arguments.steps, EPISODE, seed, *rest) for seed in range(arguments.seeds)]
    found.append(Curve(LIFE, ticks / SPANS, np.stack(lives, 1)))
    found.append(Curve(MANY, arguments.steps / SPANS, np.stack(many, 1)))
    return found, float(wired["reward_mean"]) / float(wired["seconds"])


def table_of(found: dict[str, tuple[list[Curve], float]]) -> str:
    head = ("task", "agent", "runs", "steps", "items/s in the last tenth [95 %]", "reached", "steps until then, median")
    rows = []
    for task, (each, wired) in found.items():
        for curve in each:
            last, reached = curve.rate[-len(curve.rate) // 10 :].mean(0), curve.reached(0.5 * wired)
            low, high = student(last)
            done = int((~np.isnan(reached)).sum())
            middle = f"{np.nanmedian(reached):,.0f}" if done else "never"
            steps = f"{curve.steps * len(curve.rate):,.0f}"
            shares = f"{done} of {len(last)}"
            rate = f"{last.mean():.2f} [{low:.2f}, {high:.2f}]"
            rows.append((task, spoken(curve.agent), str(len(last)), steps, rate, shares, middle))
    return table(head, rows)


@styled
def figure_of(found: dict[str, tuple[list[Curve], float]]) -> Figure:
    """A row for each task, a panel for each agent."""
    agents = len(next(iter(found.values()))[0])
    drawn, axes = figure(len(found), agents, width=11.0, height=4.8, squeeze=False, sharey="row")
    for row, (task, (each, wired)) in zip(axes, found.items(), strict=True):
        multiples(row, {c.agent: (c.steps * (np.arange(len(c.rate)) + 0.5), c.rate) for c in each})
        row[0].set_ylabel(f"{task.capitalize()}\n{style.RATE}")
        for axis in row:
            axis.axhline(wired, color=palette.of_robot(WIRED), linestyle="--", label="wired by hand (Braitenberg)")
            axis.set(xscale="log", ylim=(0, 2.0 * wired))
    for axis in axes[-1]:
        axis.set_xlabel("Time (steps)")
    legend(drawn, loc="outside lower center", ncols=5)
    return drawn


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=50, help="of the spiking robot and the tables")
    parser.add_argument("--lives", type=int, default=5, help="of PPO with one life each")
    parser.add_argument("--steps", type=int, default=300_000, help="of PPO in many worlds")
    parser.add_argument("--worlds", type=int, default=50, help="of PPO in many worlds")
    parser.add_argument("--seeds", type=int, default=3, help="of PPO in many worlds")
    parser.add_argument("--page", type=Path, help="the document that gets the table and the figure")
    parser.add_argument("override", nargs="*", help="of the experiments' configuration, like seconds=100")
    arguments = parser.parse_args(words)
    torch.set_num_threads(1)  # tensors are too small to be shared out
    found = {}
    for task, experiment in TASKS.items():
        found[task] = curves(experiment, arguments)
    page = Page(table_of(found), figure_of(found))
    print(page.table, end="")
    if arguments.page:
        page.put_into(arguments.page)
    else:
        folder = Path(mkdtemp())
        page.save(folder)
        print(f"figure in {folder}")


if __name__ == "__main__":
    main()
