"""The figures of the report: in the thesis's order, from which runs, and what is said of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from snnrl.configuration.compose import compose
from snnrl.drawing.style import spoken
from snnrl.recording.criteria import LEAD, STRENGTH
from snnrl.thesis import figures, fit, methods
from snnrl.thesis.claims import FIVE_ROBOTS, Runs
from snnrl.thesis.dampening import dampened
from snnrl.thesis.figures import SMOOTH, failure, interval, length, switch, window_of


@dataclass(frozen=True)
class Drawing:
    """A figure: the thesis's section, what it shows (some of it as the runs are), which runs it needs, and how."""

    name: str
    section: str
    caption: str | Callable[[Runs], str]
    needs: tuple[str, ...]
    draw: Callable[[Runs], Figure | None]

    def told(self, runs: Runs) -> str:
        """The caption."""
        return self.caption if isinstance(self.caption, str) else self.caption(runs)


def measured(draw: Callable[[Any], Figure | None], measure: Callable[[], Any]) -> Callable[[Runs], Figure | None]:
    """How to draw what is measured on the model and not read from runs."""
    return lambda _: draw(measure())


def poison_caption(runs: Runs) -> str:
    return f"Items collected per s; they are poison from {switch(runs['food_poison/learning']):g} s on."


def firing_caption(runs: Runs) -> str:
    return (
        f"Firing rates in trial 0 (mean of {window_of(runs['orbit/learning'], SMOOTH)[1]}): the left motor catches up "
        "with the right one until the robot leaves."
    )


def eligibility_caption(runs: Runs) -> str:
    return (
        f"Mean eligibility of the left sensor's synapses in the first {length(runs['first_eligibility'])} of trial 0."
    )


def single_caption(runs: Runs) -> str:
    return (
        f"Eligibility and weights of the left sensor's synapses in the first {length(runs['single_trial'])} of trial 0."
    )


def failure_caption(runs: Runs) -> str:
    found = failure(runs)
    assert found is not None
    name, row, side = found
    experiment, _, robot = spoken(name).partition("/")
    return (
        f"A trial that fails: trial {runs[name].trials['trial'][row]:.0f} of {robot} in {experiment}, {side} side. To "
        f"be correct, the mean weight of attraction must at the end of a trial exceed {STRENGTH:g} mV (dashed) and "
        f"{LEAD:g} times that of avoidance (dotted), on the left and on the right."
    )


def dampening_caption(runs: Runs) -> str:
    run = runs["dampening"]
    seen, weights = dampened(run), run.config["robot"]["weights"]
    falls = seen.falls.sum(0)
    return (
        "Homeostasis makes attraction and avoidance compete: every time the mean of the food taxis exceeds its limit "
        f"of {seen.limit:g} mV, all its weights fall by {seen.step:g} mV (triangles: {falls.max()} times in "
        f"{length(run)}). A run of its own, in which all of them start at {weights['food_attraction']:g} mV; that of "
        f"its {len(falls)} trials with the most falls, a sample every {1000 * interval(run):.0f} ms."
    )


def encoding_caption(_: Runs) -> str:
    config = compose("+experiment=food_attraction")
    coding = config.body()[0]
    size = config.network.groups[coding.ranges["food"].left].size
    return f"Spikes of {size} sensor neurons as the sensor's value rises from 0 to 1, one pulse every {coding.tick} ms."


def walk_caption(runs: Runs) -> str:
    return f"The path of a robot that senses nothing, for {length(runs['random_walk'])}, unrolled from the torus."


def orbit_caption(runs: Runs) -> str:
    return (
        "A robot attracted with full weights orbits the item (left, not learning); hunger gets it off (right). A dot "
        f"every {1000 * interval(runs['orbit/learning']):.0f} ms."
    )


ORBIT = tuple(f"orbit/{robot}" for robot in ("learning_disabled", "learning", "positive_baseline"))
FIVE = tuple(f"secondary_behaviour/{robot}" for robot in FIVE_ROBOTS)
DUAL = tuple(f"dual_learning/{robot}" for robot in ("random_walk", "learning", "benchmark"))
STIMULUS = ("secondary_stimulus/learning", "secondary_stimulus/no_burst_threshold")

DRAWINGS = (
    Drawing(
        "environments",
        "3.1",
        "The three worlds at the start of trial 0: item discs, containers, robot.",
        (),
        measured(figures.environments, methods.environments),
    ),
    Drawing(
        "sensor_encoding",
        "3.5",
        encoding_caption,
        (),
        measured(figures.encoding, methods.encoding),
    ),
    Drawing(
        "stdp_window",
        "3.7",
        "The STDP window, and the eligibility of one synapse after one pair of spikes.",
        (),
        measured(figures.window, methods.window),
    ),
    Drawing(
        "coincidence_food",
        "3.8",
        "How the food container's touch comes to release dopamine: a chance pair of spikes is still "
        "eligible when food is taken.",
        ("secondary_stimulus/learning",),
        measured(figures.coincidence, partial(methods.chance, "learning", "food_container", True)),
    ),
    Drawing(
        "dampening",
        "3.9",
        dampening_caption,
        ("dampening",),
        figures.dampening,
    ),
    Drawing(
        "stdp_search",
        "3.7",
        "Food collected over two planes of STDP's parameters through the values used (centre); dots: "
        "not worse than the best (one-sided Welch test, 5 %).",
        ("stdp_search",),
        fit.heat_maps,
    ),
    Drawing(
        "random_walk",
        "3.11",
        walk_caption,
        ("random_walk",),
        figures.walk_path,
    ),
    Drawing(
        "orbit_path",
        "4.1",
        orbit_caption,
        ORBIT,
        figures.orbit_path,
    ),
    Drawing(
        "orbit_distance",
        "4.1",
        "Distance to the item in trial 0 of each robot; green: the learning robot takes food. Ticks "
        "at the bottom: escapes of all its trials.",
        ORBIT,
        figures.orbit_distance,
    ),
    Drawing(
        "orbit_weights",
        "4.1",
        "Weights of trial 0 in orbit. Under hunger the active pathway weakens and the inactive one of"
        " the same sensor rises; with a positive baseline the orbit is reinforced.",
        ORBIT,
        figures.orbit_weights,
    ),
    Drawing(
        "orbit_firing",
        "4.1",
        firing_caption,
        ORBIT,
        figures.orbit_firing,
    ),
    Drawing(
        "food_rates",
        "4.2",
        "Food collected per s, mean over trials with its 95 % interval and, paler, the standard deviation over trials.",
        ("food_attraction/learning", "food_attraction/random_walk"),
        figures.food_rates,
    ),
    Drawing(
        "food_weights",
        "4.2",
        "Mean weights over trials in food attraction; areas as above.",
        ("food_attraction/learning",),
        figures.food_weights,
    ),
    Drawing(
        "first_eligibility",
        "4.2",
        eligibility_caption,
        ("first_eligibility",),
        figures.first_eligibility,
    ),
    Drawing(
        "single_trial",
        "4.2",
        single_caption,
        ("single_trial",),
        figures.single_trial,
    ),
    Drawing(
        "weight_matrix",
        "4.2",
        "Weights at the end of trial 0. Rows that are dark on one side only are motor neurons that "
        "answer to one sensor only.",
        ("food_attraction/learning",),
        figures.weight_matrix,
    ),
    Drawing(
        "poison_rates",
        "4.3",
        poison_caption,
        ("food_poison/learning", "food_poison/random_walk"),
        figures.poison_rates,
    ),
    Drawing(
        "poison_eligibility",
        "4.3",
        "Mean eligibility of the left sensor's synapses in trial 0 around the switch.",
        ("poison_switch",),
        figures.poison_eligibility,
    ),
    Drawing(
        "poison_weights",
        "4.3",
        "Mean weights over trials before and after the switch, and a close-up of what remains.",
        ("food_poison/learning",),
        figures.poison_weights,
    ),
    Drawing(
        "stimulus_weights",
        "4.4",
        "The touch of the food container comes to excite dopaminergic neurons, that of the empty one "
        "does not, thanks to the burst threshold.",
        STIMULUS,
        figures.stimulus_weights,
    ),
    Drawing(
        "coincidence_empty",
        "4.4",
        "Without the threshold a chance pair at an empty container releases dopamine itself and "
        "strengthens its own synapse.",
        ("secondary_stimulus/no_burst_threshold",),
        measured(figures.coincidence, partial(methods.chance, "no_burst_threshold", "empty_container", False)),
    ),
    Drawing("robots_rates", "4.5", "Food collected per s by the five robots.", FIVE, figures.robots_rates),
    Drawing(
        "robots_totals",
        "4.5",
        "Food of each trial, mean and standard deviation, beside the published ones.",
        FIVE,
        figures.food_totals,
    ),
    Drawing(
        "container_touch",
        "4.5",
        "Weights from the food container's touch to dopaminergic neurons in the robot that learns them.",
        ("secondary_behaviour/container_dopamine_learning",),
        figures.container_touch_weights,
    ),
    Drawing(
        "fixed_weights",
        "4.5",
        "Mean container weights over trials of the robot whose container dopamine is fixed.",
        ("secondary_behaviour/fixed_container_dopamine",),
        figures.fixed_weights,
    ),
    Drawing(
        "failing_trial",
        "4.5",
        failure_caption,
        ("secondary_behaviour/fixed_container_dopamine", "dual_learning/learning"),
        figures.failing_trial,
    ),
    Drawing(
        "dual_rates",
        "4.6",
        "Food collected per s when both behaviours are learnt from nothing.",
        DUAL,
        figures.dual_rates,
    ),
    Drawing(
        "dual_weights",
        "4.6",
        "Mean weights over trials of the robot that learns both behaviours.",
        ("dual_learning/learning",),
        figures.dual_weights,
    ),
    Drawing("calibration", "fit", "The search for the free values: distance to all published cells.", (), fit.history),
    Drawing(
        "pinned",
        "fit",
        "How well each free value is pinned: every point of the search that all cells have judged, by its value.",
        (),
        fit.pinned,
    ),
    Drawing(
        "fronts",
        "fit",
        "What cannot be had together: distances from cells that pull against each other.",
        (),
        fit.fronts,
    ),
    Drawing(
        "sensitivity",
        "fit",
        "How sharply each cell pins each free value: change of its distance when one value is changed, where it is at"
        " least 0.5.",
        (),
        fit.sensitivity,
    ),
)


def drawings(runs: Runs) -> list[tuple[Drawing, Figure]]:
    """All whose runs are there and that have something to show."""
    result = []
    for drawing in DRAWINGS:
        if all(name in runs or any(run.startswith(f"{name}/") for run in runs) for name in drawing.needs):
            drawn = drawing.draw(runs)
            if drawn is not None:
                result.append((drawing, drawn))
    return result
