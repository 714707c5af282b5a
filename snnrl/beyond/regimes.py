"""Dose against hunger: where robots learn, by how much dopamine an item releases and how much the motors explore.

The mean-field argument: a synapse onto a neuron that fires from exploration alone has a negative eligibility. It would
grow, until its own spikes make the eligibility positive, only while dopamine is negative on average: while hunger takes
more than food gives. That is below the dose at which the mean of a robot that has learnt nothing is zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from snnrl.beyond.page import Page, table
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.drawing.style import figure, legend, styled
from snnrl.engines import make_engine
from snnrl.recording.criteria import correct
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD, Config
from snnrl.simulation import Simulation

WORLDS = {  # experiment, a robot that learns, and one that does not
    "food": ("food_attraction", "learning", "random_walk"),
    "food in containers": ("secondary_behaviour", "container_dopamine_learning", "learning_disabled"),
}
RELEASE = (0.25, 0.5, 1.0, 2.0, 4.0)  # factors on what a spike releases
EXPLORATION = (0.6, 0.8, 1.0, 1.25, 1.6)  # factors on the gain of exploration


@dataclass(frozen=True)
class Regimes:
    """One world.

    Attributes:
        gain: of exploration, [E].
        dose: dopamine from an item, [E, D], uM ms.
        threshold: the dose at which the mean dopamine of a robot that does not learn is zero, [E], uM ms.
        learnt: share of trials, [E, D].
    """

    gain: np.ndarray
    dose: np.ndarray
    threshold: np.ndarray
    learnt: np.ndarray


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """Run both worlds at all points; `part` of the published length, for a trial."""
    found = {world: regimes(*names, overrides, part) for world, names in WORLDS.items()}
    return Page(_table(found), figure_of(found))


def regimes(experiment: str, learning: str, still: str, overrides: Sequence[str], part: float = 1.0) -> Regimes:
    """Of one world, from runs of a robot that learns at all points, and of one that does not at each exploration."""
    usual = compose(f"+experiment={experiment}", *overrides)
    gains = [factor * usual.body()[0].exploration_gain for factor in EXPLORATION]
    dopamine = usual.network.dopamine
    assert dopamine is not None
    doses: list[list[float]] = []
    learnt: list[list[float]] = []
    thresholds = []
    for gain in gains:
        named = (f"+experiment={experiment}", *overrides, f"coding.exploration_gain={gain:g}")
        dose, threshold = dose_and_threshold(*run(compose(*named, f"robot={still}"), part))
        doses.append([factor * dose for factor in RELEASE])
        thresholds.append(threshold)
        learnt.append([])
        for factor in RELEASE:
            release = f"network.dopamine.release={factor * dopamine.release:g}"
            simulation, config = run(compose(*named, f"robot={learning}", release), part)
            learnt[-1].append(float(correct(simulation.network, config.experiment.correct).double().mean()))
    return Regimes(np.array(gains), np.array(doses), np.array(thresholds), np.array(learnt))


def run(config: Config, part: float) -> tuple[Simulation, Config]:
    """A simulation of a part of its length, ended."""
    simulation, engine = build(config), make_engine(config.engine, config.device, config.threads)
    simulation.run(engine, ticks_of(part * config.seconds, simulation.tick))
    return simulation, config


def dose_and_threshold(simulation: Simulation, config: Config) -> tuple[float, float]:
    """What an item has released on average, and what it may release if dopamine is not to be positive, uM ms.

    What background firing releases is counted with the items.
    """
    dopamine, ms = simulation.network.dopamine, float(simulation.network.time)
    assert dopamine is not None
    items = float(simulation.situation.world.count(FOOD).double().mean())
    released = float(dopamine.total.double().mean()) - dopamine.baseline * ms
    return released / items, -dopamine.baseline * ms / items


def _table(found: dict[str, Regimes]) -> str:
    head = ("world", "exploration gain", "threshold, uM ms", *(f"release x {factor:g}" for factor in RELEASE))
    rows = [
        (
            world,
            f"{gain:.3g}",
            f"{threshold:.2f}",
            *(f"{100 * share:.0f} % at {dose:.2f}" for share, dose in zip(shares, doses, strict=True)),
        )
        for world, regime in found.items()
        for gain, threshold, shares, doses in zip(
            regime.gain, regime.threshold, regime.learnt, regime.dose, strict=True
        )
    ]
    return table(head, rows)


@styled
def figure_of(found: dict[str, Regimes]) -> Figure:
    drawn, axes = figure(1, len(found), width=8.4, height=3.6)
    for axis, (world, regime) in zip(axes, found.items(), strict=True):
        gains = np.broadcast_to(regime.gain[:, None], regime.dose.shape)
        points = axis.scatter(
            regime.dose, gains, c=100 * regime.learnt, s=260, cmap="cividis", vmin=0, vmax=100, edgecolors="0.3"
        )
        axis.plot(regime.threshold, regime.gain, color="black", label="mean dopamine 0 before learning")
        axis.set(xscale="log", xlabel="Dose of an item (µM ms)", title=world)
        axis.set(ylabel="Gain of exploration" if axis is axes[0] else "")
    legend(drawn, loc="outside lower center")
    drawn.colorbar(points, ax=list(axes), label="Trials that learn (%)")
    return drawn
