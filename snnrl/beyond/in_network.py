"""Rhythm, winner-takes-all and exploration inside the network, one at a time and together, against all three outside.

A robot that does one of them inside is compared with the thesis' robot, and with itself without the inhibition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.signal import welch

from snnrl.beyond.course import interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.drawing import style
from snnrl.drawing.palette import of_robot
from snnrl.drawing.style import figure, legend, multiples, spoken, styled
from snnrl.engines import Engine, make_engine
from snnrl.recording.criteria import correct
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD, Config
from snnrl.simulation import Simulation

DUAL = "dual learning"
TASKS = {
    "food attraction": ("+experiment=in_network",),
    "without learning": ("+experiment=in_network", "robot.learning=false"),
    DUAL: ("+experiment=in_network_dual",),
}
DRAWN = ("food attraction", DUAL)
ROBOTS = ("learning", "phasic", "no_rhythm", "winner", "no_rivalry", "background", "in_network")
SPANS = 40  # in which food is counted
WATCHED = 20.0  # s behind them, in which spikes are
RHYTHM = "rhythm"
MOTORS = ("left_motor", "right_motor")
SENSORS = ("left_food", "right_food")
FAR_SENSORS = ("left_container", "right_container")
WON = 0.9  # of the spikes of two groups, those of one that has won
SEGMENT = 2048  # ms, of Welch's method
AUDIBLE = (1.0, 100.0)  # Hz, in which a spectrum is looked at
NEAR = (10.0, 20.0)  # Hz, of it, near one cycle a tick


@dataclass(frozen=True)
class Life:
    """A robot's in one task.

    Attributes:
        time: of the ends of the spans, [T], s. food: collected, [T, B], items/s.
        learnt: whether each trial has learnt what the experiment asks for, bool [B].
        tick: ms. spikes: int64 [ms, B], by group, behind the last span.
        rhythmic: whether the rhythm silences anything.
    """

    task: str
    robot: str
    time: np.ndarray
    food: np.ndarray
    learnt: np.ndarray
    tick: int
    spikes: dict[str, np.ndarray]
    rhythmic: bool

    @property
    def motors(self) -> np.ndarray:
        """Spikes of both, int64 [ms, B]."""
        return self.spikes[MOTORS[0]] + self.spikes[MOTORS[1]]

    def won(self, pair: tuple[str, str]) -> float:
        """Share of the ticks with spikes of two groups in which one of the groups has won; nan if there are none."""
        left, right = (self.spikes[name].reshape(-1, self.tick, self.learnt.size).sum(1) for name in pair)
        active = left + right > 0
        one = np.maximum(left, right) >= WON * (left + right)
        return float(one[active].mean()) if active.any() else np.nan


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run all robots in all tasks; `part` of the time, for a trial."""
    lives = [live(task, robot, overrides, part) for task in TASKS for robot in ROBOTS]
    return Page(_table(lives), figure_of(lives))


def live(task: str, robot: str, overrides: Sequence[str], part: float = 1.0) -> Life:
    """Run one robot in one task."""
    config = compose(*TASKS[task], f"robot={robot}", *overrides)
    simulation, engine = build(config), make_engine(config.engine, config.device, config.threads)
    ticks = ticks_of(part * config.seconds / SPANS, simulation.tick)
    counts = [torch.zeros(config.trials)]
    for _ in range(SPANS):
        simulation.run(engine, ticks)
        counts.append(simulation.situation.world.count(FOOD).clone())
    every = ticks * simulation.tick / 1000.0
    return Life(
        task,
        robot,
        every * np.arange(1, SPANS + 1),
        torch.stack(counts).diff(dim=0).numpy() / every,
        correct(simulation.network, config.experiment.correct).numpy(),
        simulation.tick,
        watch(simulation, engine, ticks_of(WATCHED, simulation.tick)),
        _gated(config),
    )


def _gated(config: Config) -> bool:
    return config.network.synapses["gate"].weight != 0.0


def watch(simulation: Simulation, engine: Engine, ticks: int) -> dict[str, np.ndarray]:
    """Spikes of rhythm, motors and range sensors in the coming ticks, int64 [ms, B] by group."""
    network = simulation.network
    raster = torch.zeros(simulation.tick, network.trials, network.size, dtype=torch.bool)
    counts: dict[str, list[torch.Tensor]] = {name: [] for name in (RHYTHM, *MOTORS, *SENSORS, *FAR_SENSORS)}
    for _ in range(ticks):
        simulation.run(engine, 1, raster)
        for name, count in counts.items():
            count.append(raster[..., network.groups[name].span].sum(-1))
    return {name: torch.cat(count).numpy() for name, count in counts.items()}


def spectrum(spikes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and the power density of a group's spikes [ms, B] at each, mean over trials, both [F]."""
    frequency, power = welch(spikes, 1000.0, nperseg=SEGMENT, axis=0)
    heard = (frequency >= AUDIBLE[0]) & (frequency <= AUDIBLE[1])
    return frequency[heard], power[heard].mean(1)


def peak(spikes: np.ndarray) -> tuple[float, float]:
    """The frequency (Hz) with the most power, and the share of all power that is near a cycle a tick."""
    frequency, power = spectrum(spikes)
    near = (frequency >= NEAR[0]) & (frequency <= NEAR[1])
    return float(frequency[power.argmax()]), float(power[near].sum() / power.sum())


def _table(lives: Sequence[Life]) -> str:
    head = (
        *("task", "robot", "food per s [95 %]", "learnt", "rhythm, Hz", "of its power"),
        *("of the motors' power", "one motor wins", "one sensor wins"),
    )
    return table(head, map(_row, lives))


def _row(life: Life) -> tuple[str, ...]:
    hertz, share = peak(life.spikes[RHYTHM])
    _, passed_on = peak(life.motors)
    sensors = FAR_SENSORS if life.task == DUAL else SENSORS
    return (
        life.task,
        life.robot.replace("_", " "),
        interval(life.food.mean(0), 3),
        f"{100 * life.learnt.mean():.0f} %",
        *((f"{hertz:.1f}", f"{100 * share:.0f} %") if life.rhythmic else ("", "")),
        f"{100 * passed_on:.0f} %",
        f"{100 * life.won(MOTORS):.0f} %",
        f"{100 * life.won(sensors):.0f} %",
    )


@styled
def figure_of(lives: Sequence[Life]) -> Figure:
    """Food per s over time, a row for each task and a panel for each robot; below, spectra of rhythm and motors."""
    drawn, axes = figure(len(DRAWN) + 1, len(ROBOTS), width=11.0, height=6.4, squeeze=False, sharey="row")
    for row, task in zip(axes, DRAWN, strict=False):
        multiples(row, {life.robot: (life.time, life.food) for life in lives if life.task == task})
        row[0].set_ylabel(f"{task.capitalize()}\n{style.RATE}")
        for axis in row:
            axis.set(xlim=(0, None), ylim=(0, None), xlabel=style.TIME)
    of_task = {life.robot: life for life in lives if life.task == DRAWN[0]}
    for axis, (robot, life) in zip(axes[-1], of_task.items(), strict=False):
        axis.semilogy(*spectrum(life.motors), color=of_robot(robot), label="motors")
        if life.rhythmic:
            axis.semilogy(*spectrum(life.spikes[RHYTHM]), color=style.palette.OTHER, linestyle="dotted", label="rhythm")
        axis.set(xlim=(0, AUDIBLE[1]), xlabel="Frequency (Hz)", title=spoken(robot))
    axes[-1, 0].set_ylabel("Power (spikes²/ms²/Hz)")
    legend(drawn, loc="outside lower center", ncols=5)
    return drawn
