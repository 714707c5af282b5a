"""Agents without neurons against the spiking robot that learns, in the same worlds: a table and a plot.

    python -m snnrl.run +experiment=baselines [trials=N] [seconds=S] [seed=K] [agents=[...]]

`trials` and `seconds` are each task's own unless given: at the published sizes this takes many minutes.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from matplotlib.figure import Figure
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from snnrl.agents.agents import Agent, Braitenberg, QLearning, RandomWalk, Reinforce, SarsaLambda
from snnrl.agents.foraging import Foraging
from snnrl.body.world import World
from snnrl.configuration.builder import build
from snnrl.configuration.checks import check, torch_device
from snnrl.configuration.compose import plain
from snnrl.drawing import style
from snnrl.drawing.style import figure, legend, multiples, spoken, styled
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.files import csv_of, npz_of, write
from snnrl.intervals import student
from snnrl.model.draws import Draws
from snnrl.running.command import Passed, discard
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD, BaselinesConfig, Config, check_bounds

SPIKING = "spiking"  # the robot that learns
AGENTS: Mapping[str, Callable[[Draws, int, BaselinesConfig], Agent]] = {
    "random_walk": lambda draws, sensors, config: RandomWalk(draws),
    "braitenberg": lambda draws, sensors, config: Braitenberg(draws, config.braitenberg),
    "q_learning": lambda draws, sensors, config: QLearning(draws, sensors, config.q_learning),
    "sarsa_lambda": lambda draws, sensors, config: SarsaLambda(draws, sensors, config.sarsa_lambda),
    "reinforce": lambda draws, sensors, config: Reinforce(draws, sensors, config.reinforce),
}
LATE = 0.2  # the last part of a task, in which what has been learnt shows


@dataclass(frozen=True)
class Result:
    """What one agent collected in one task.

    Attributes:
        time: float64 [T], s, the ends of the spans that are counted.
        items: int64 [T, B], taken in each span.
        poison: bool [T], whether items were poison in that span.
    """

    task: str
    agent: str
    time: np.ndarray
    items: np.ndarray
    poison: np.ndarray

    @property
    def spans(self) -> np.ndarray:
        """Length of each span, [T], s."""
        return np.diff(self.time, prepend=0.0)

    def row(self) -> dict[str, str | int | float]:
        """A row of the table: means and standard deviations over trials, 95 % interval of the mean reward."""
        trials = self.items.shape[1]
        food, poison = self.items[~self.poison].sum(0), self.items[self.poison].sum(0)
        reward = food - poison
        low, high = student(reward) if trials > 1 else (math.nan, math.nan)
        late = self.time > (1 - LATE) * self.time[-1]
        return {
            "task": self.task,
            "agent": self.agent,
            "trials": trials,
            "seconds": float(self.time[-1]),
            "food_mean": food.mean(),
            "food_sd": food.std(ddof=1) if trials > 1 else math.nan,
            "poison_mean": poison.mean(),
            "poison_sd": poison.std(ddof=1) if trials > 1 else math.nan,
            "reward_mean": reward.mean(),
            "reward_low": low,
            "reward_high": high,
            "late_rate": self.items[late].sum(0).mean() / self.spans[late].sum(),
        }


def length_of(config: Config) -> tuple[int, int | None]:
    """How many ticks a task has, and the first one in which food is poison; None where it never turns."""
    coding, world = config.body()
    ticks = ticks_of(config.seconds, coding.tick)
    return ticks, None if world.poison_from is None else math.ceil(round(1000 * world.poison_from) / coding.tick)


def marks_of(config: Config, samples: int) -> list[int]:
    """The ticks after which to count: `samples` of them, evenly spread; the nearest moves to food's turn to poison."""
    ticks, turn = length_of(config)
    marks = {round(ticks * (k + 1) / samples) for k in range(samples)} - {0}
    if turn is not None:
        marks = {mark for mark in marks if abs(mark - turn) >= 0.5 * ticks / samples} | {turn, ticks}
    return sorted(mark for mark in marks if 0 < mark <= ticks)


def spiking_robot(config: Config) -> tuple[World, Callable[[int], None]]:
    """The world of the spiking robot of a task, and what runs it for so many ticks."""
    simulation = build(config)
    engine = make_engine(config.engine, config.device, config.threads)
    return simulation.situation.world, lambda ticks: simulation.run(engine, ticks)


def agent_robot(config: Config, name: str, options: BaselinesConfig) -> tuple[World, Callable[[int], None]]:
    """The world of the agent of that name, and what runs it for so many ticks."""
    trials = torch.arange(config.trial_start, config.trial_start + config.trials, device=config.device)
    draws = Draws(config.seed, trials)
    body = Foraging(config, draws)
    agent = AGENTS[name](draws, len(body.coding.ranges), options)
    reward = torch.zeros(len(trials), dtype=torch.float64, device=trials.device)

    def advance(ticks: int) -> None:
        for _ in range(ticks):
            reward.copy_(body.step(body.wheels(agent.act(body.ranges(), reward, body.time))))

    return body.world, advance


def collect(task: str, agent: str, config: Config, options: BaselinesConfig) -> Result:
    """Run one agent through one task."""
    world, advance = spiking_robot(config) if agent == SPIKING else agent_robot(config, agent, options)
    marks = marks_of(config, options.samples)
    counts: list[Tensor] = [world.count(FOOD).cpu().clone()]
    for before, mark in zip([0, *marks], marks, strict=False):
        advance(mark - before)
        counts.append(world.count(FOOD).cpu().clone())
    coding, described = config.body()
    poison_from = math.inf if described.poison_from is None else described.poison_from
    tick = coding.tick / 1000.0
    return Result(
        task,
        agent,
        np.array(marks) * tick,
        torch.stack(counts).diff(dim=0).numpy(),
        np.array([0, *marks[:-1]]) * tick >= poison_from,
    )


def table_of(results: Sequence[Result]) -> str:
    """All rows as CSV."""
    rows = [result.row() for result in results]
    return csv_of(list(rows[0]), [[f"{v:.6g}" if isinstance(v, float) else v for v in row.values()] for row in rows])


def markdown_of(results: Sequence[Result]) -> str:
    """All rows as a table in Markdown."""
    lines = [
        "| task | agent | trials x s | food, mean (SD) | poison, mean (SD) | reward, mean [95 %] | late items/s |",
        "|---|---|---|---|---|---|---|",
    ]
    for result in results:
        row = result.row()
        poison = f"{row['poison_mean']:.1f} ({row['poison_sd']:.1f})" if result.poison.any() else ""
        lines.append(
            f"| {row['task']} | {row['agent']} | {row['trials']} x {row['seconds']:.0f} "
            f"| {row['food_mean']:.1f} ({row['food_sd']:.1f}) | {poison} "
            f"| {row['reward_mean']:.1f} [{row['reward_low']:.1f}, {row['reward_high']:.1f}] "
            f"| {row['late_rate']:.3f} |"
        )
    return "\n".join(lines) + "\n"


@styled
def figure_of(results: Sequence[Result]) -> Figure:
    """Collection rate over time, a row for each task and a panel for each agent."""
    tasks = list(dict.fromkeys(result.task for result in results))
    agents = list(dict.fromkeys(result.agent for result in results))
    drawn, axes = figure(
        len(tasks),
        len(agents),
        1.7 * len(agents) + 0.8,
        1.7 * len(tasks) + 0.6,
        squeeze=False,
        sharex="row",
        sharey="row",
    )
    for row, task in zip(axes, tasks, strict=True):
        of = [result for result in results if result.task == task]
        multiples(row, {result.agent: (result.time, result.items / result.spans[:, None]) for result in of})
        row[0].set(ylabel=f"{spoken(task).capitalize()}\n{style.RATE}", xlim=(0, of[0].time[-1]), ylim=(0, None))
        for axis, result in zip(row, of, strict=True):
            if result.poison.any() and (~result.poison).any():
                style.mark(axis, result.time[~result.poison][-1], "poison", vertical=True)
    for axis in axes[-1]:
        axis.set(xlabel=style.TIME)
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn


def save(results: Sequence[Result], folder: Path) -> None:
    """Write baselines.csv, baselines.md, the figure as baselines.png and baselines.svg, and series.npz.

    series.npz holds, for each TASK and AGENT, `TASK.AGENT.time` [T] (s) and `TASK.AGENT.items` [T, B].
    """
    write(folder / "baselines.csv", table_of(results))
    write(folder / "baselines.md", markdown_of(results))
    style.save(figure_of(results), folder / "baselines")
    arrays = {f"{r.task}.{r.agent}.{key}": getattr(r, key) for r in results for key in ("time", "items")}
    write(folder / "series.npz", npz_of(arrays))


def tasks_of(options: BaselinesConfig) -> dict[str, Config]:
    """The configuration of every task, composed by the Hydra that runs.

    Raises:
        ConfigError: if there is no task or no such agent, a value is out of bounds, or a task is over before its
            food turns to poison.
    """
    check_bounds(options)
    allowed = [SPIKING, *AGENTS]
    for agent in options.agents:
        if agent not in allowed:
            raise ConfigError("agents", agent, f"must be one of {', '.join(allowed)}")
    for key in ("tasks", "agents"):
        if not getattr(options, key):
            raise ConfigError(key, "empty", "at least one is needed")
    given = {"trials": options.trials, "seconds": options.seconds, "seed": options.seed}
    overrides = [f"{key}={value}" for key, value in given.items() if value is not None]
    tasks: dict[str, Config] = {
        name: plain(hydra.compose("config", overrides=[*task, *overrides])) for name, task in options.tasks.items()
    }
    for name, config in tasks.items():
        check(config)
        torch_device(config.device)
        _check_turn(name, config)
    return tasks


def _check_turn(task: str, config: Config) -> None:
    """Raise ConfigError if a task's food turns to poison, as which it would be listed, too late, or more than once."""
    ticks, turn = length_of(config)
    _, world = config.body()
    for kind, described in world.kinds.items():
        if described.turns_every is not None:
            allowed = f"world.kinds.{kind}.turns_every must be null, what is listed as poison turns to it once"
            raise ConfigError(f"tasks.{task}", "...", allowed)
    if turn is not None and turn >= ticks:
        allowed = f"must be greater than the {world.poison_from:g} s after which food turns to poison in {task}"
        raise ConfigError("seconds", config.seconds, f"{allowed} (leave that task out with ~tasks.{task})")


def job(composed: DictConfig) -> None:
    """One Hydra job: all agents through all tasks."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    try:
        options: BaselinesConfig = plain(composed)
        tasks = tasks_of(options)
    except (ConfigError, HydraException) as error:
        discard(folder)
        if HydraConfig.get().mode == RunMode.RUN:
            raise Passed(error) from error
        raise
    write(folder / "config.yaml", OmegaConf.to_yaml(composed, resolve=True))
    torch.set_num_threads(1)  # an agent's operations are too small to be shared out
    results = []
    for task, config in tasks.items():
        for agent in options.agents:
            print(f"baselines  {task}  {agent}  {config.trials} trials x {config.seconds:.0f} s", file=sys.stderr)
            results.append(collect(task, agent, config, options))
    save(results, folder)
    print(markdown_of(results), end="")
    print(f"results in {folder}")
