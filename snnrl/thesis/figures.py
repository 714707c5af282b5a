"""The thesis's figures, redrawn from our runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from snnrl.body.world import World
from snnrl.drawing import charts, style
from snnrl.drawing.palette import (
    ATTRACTION,
    AVOIDANCE,
    DOPAMINE,
    FOOD,
    GROUPS,
    LEFT,
    OTHER,
    POISON,
    RIGHT,
    ROBOTS,
)
from snnrl.drawing.pictures import draw_world
from snnrl.drawing.style import PUBLISHED, above, band, figure, legend, mark, multiples, spoken, styled
from snnrl.recording.criteria import LEAD, STRENGTH
from snnrl.recording.runs import Run
from snnrl.thesis.claims import FIVE_ROBOTS, SIDES, Runs, escapes, pathways, smooth, taxis
from snnrl.thesis.dampening import dampened
from snnrl.thesis.methods import Coincidence, Window
from snnrl.thesis.published import published

SMOOTH = 0.5  # s, of firing rates


def interval(run: Run) -> float:
    """Between two samples, s."""
    return round(float(np.diff(run.time[:2])[0]), 6)


def window_of(run: Run, seconds: float) -> tuple[int, str]:
    """Samples in about so many s, at least one, and how long they are in words."""
    samples = max(1, round(seconds / interval(run)))
    return samples, f"{samples * interval(run):.2g} s"


def length(run: Run) -> str:
    """In words."""
    return f"{run.config['seconds']:g} s"


FEW = 3  # robots whose areas can be told apart on the same axes


@styled
def rates(runs: Runs, experiment: str, robots: tuple[str, ...], bins: int = 100) -> Figure:
    """Collection rate of several robots, smoothed over 1/`bins` of the time; of more than FEW, in a panel each."""
    found = {robot: smoothed_rate(runs[f"{experiment}/{robot}"], bins) for robot in robots}
    if len(robots) > FEW:
        columns = -(-len(robots) // 2)
        drawn, axes = figure(2, columns, width=7.2, height=4.4, sharex=True, sharey=True)
        multiples(axes.flat, found)
        for axis in axes.flat[len(robots) :]:
            axis.set_axis_off()
        for k, axis in enumerate(axes.flat[: len(robots)]):
            below = k + columns >= len(robots)
            axis.tick_params(labelbottom=below)
            axis.set(xlabel=style.TIME if below else "", ylabel="" if k % columns else style.RATE, ylim=(0, None))
        legend(drawn, loc="lower right", bbox_to_anchor=(0.98, 0.14))
        return drawn
    drawn, axis = figure(height=3.4)
    for robot, (time, rate) in found.items():
        charts.learning_curve(axis, time, rate, ROBOTS[robot], spoken(robot))
    legend(axis, **above())
    return drawn


def smoothed_rate(run: Run, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Times [n] and items per s [n, B] of `bins` parts of the time."""
    width = max(1, len(run.time) // bins)
    return run.time[width - 1 :: width], smooth(run.series["collection_rate"], width)[width - 1 :: width]


@styled
def food_rates(runs: Runs) -> Figure:
    drawn = rates(runs, "food_attraction", ("random_walk", "learning"))
    mark(drawn.axes[0], published()["said"]["attraction_settled"], "published: settled", vertical=True)
    return drawn


@styled
def poison_rates(runs: Runs) -> Figure:
    drawn = rates(runs, "food_poison", ("random_walk", "learning"), 200)
    mark(drawn.axes[0], switch(runs["food_poison/learning"]), "food turns to poison", vertical=True)
    return drawn


@styled
def robots_rates(runs: Runs) -> Figure:
    return rates(runs, "secondary_behaviour", FIVE_ROBOTS, 40)


@styled
def dual_rates(runs: Runs) -> Figure:
    return rates(runs, "dual_learning", ("random_walk", "learning", "benchmark"), 50)


def switch(run: Run) -> float:
    """When food turns to poison, s."""
    return float(run.config["world"]["kinds"]["food"]["poison_from"])


@styled
def food_totals(runs: Runs) -> Figure:
    """Food of each of the five robots as points, means with intervals, beside the published means and SDs."""
    drawn, axis = figure(height=3.4)
    theirs = published()["food"]["secondary_behaviour"]
    for k, robot in enumerate(FIVE_ROBOTS):
        food = runs[f"secondary_behaviour/{robot}"].trials["food"]
        spread = 0.18 * (np.arange(len(food)) / max(len(food) - 1, 1) - 0.5)
        axis.plot(k - 0.15 + spread, food, ".", color=ROBOTS[robot], alpha=0.45, markersize=4, label="a trial")
        axis.errorbar(k + 0.02, food.mean(), food.std(), fmt="o", color=ROBOTS[robot], capsize=3, label="mean and SD")
        value = theirs[robot]
        label = "published mean and SD"
        colour = PUBLISHED["color"]
        axis.errorbar(k + 0.22, value["mean"], value["sd"], fmt="D", color=colour, mfc="white", capsize=3, label=label)
    axis.set_xticks(range(5), [spoken(robot).replace(" ", "\n") for robot in FIVE_ROBOTS])
    axis.set(ylabel="Food in a trial (items)", ylim=(0, None))
    legend(axis, loc="upper left")
    return drawn


def taxis_weights(runs: Runs, name: str, sense: str, axes: Iterable[Axes]) -> None:
    """Mean weights over trials, of each sensor to each motor: axes for the left sensor, and for the right one."""
    run = runs[name]
    for axis, side, other in zip(axes, SIDES, reversed(SIDES), strict=True):
        for motor, colour, label in ((other, ATTRACTION, "attraction"), (side, AVOIDANCE, "avoidance")):
            values = run.of_projection("weight", f"{side}_{sense}_to_{motor}_motor")
            band(axis, run.time, values, colour, label)
        axis.set(xlabel=style.TIME, xlim=(0, run.time[-1]), ylim=(0, 3.6), title=f"from the {side} {sense} sensor")
        mark(axis, largest_mean(run, "taxis"), "largest possible mean")


def largest_mean(run: Run, synapse: str) -> float:
    """Mean weight over all pairs if every synapse of that kind had its largest weight, mV."""
    network = run.config["network"]
    return float(network["synapses"][synapse]["probability"] * network["plasticity"]["weight_max"])


@styled
def food_weights(runs: Runs) -> Figure:
    return one_taxis(runs, "food_attraction/learning", "food")


@styled
def fixed_weights(runs: Runs) -> Figure:
    return one_taxis(runs, "secondary_behaviour/fixed_container_dopamine", "container")


def one_taxis(runs: Runs, name: str, sense: str) -> Figure:
    drawn, axes = figure(1, 2, sharey=True)
    taxis_weights(runs, name, sense, axes)
    axes[0].set(ylabel=style.MEAN_WEIGHT)
    legend(drawn, loc="outside lower center", ncols=2)
    return drawn


@styled
def dual_weights(runs: Runs) -> Figure:
    drawn, axes = figure(2, 3, width=9.0, height=5.0, sharex=True)
    for row, sense in zip(axes, ("food", "container"), strict=True):
        taxis_weights(runs, "dual_learning/learning", sense, row[:2])
        row[0].set(ylabel=style.MEAN_WEIGHT)
    for axis in axes[0]:
        axis.set(xlabel="")
    touch_weights(axes[1, 2], runs["dual_learning/learning"], ("food_container",))
    axes[0, 2].set_axis_off()
    legend(drawn, loc="outside lower center", ncols=3)
    return drawn


def touch_weights(axis: Axes, run: Run, touches: tuple[str, ...]) -> None:
    colours = {"food_container": FOOD, "empty_container": OTHER}
    values = {touch: run.of_projection("weight", f"{touch}_touch_to_dopaminergic") for touch in touches}
    looks = {touch: {"color": colours[touch], "label": f"{spoken(touch)} touch"} for touch in touches}
    charts.courses(axis, run.time, values, style.MEAN_WEIGHT, **looks)
    axis.set(xlim=(0, run.time[-1]), ylim=(0, 0.46))
    mark(axis, largest_mean(run, "anticipation"), "largest possible mean")


@styled
def container_touch_weights(runs: Runs) -> Figure:
    drawn, axis = figure()
    touch_weights(axis, runs["secondary_behaviour/container_dopamine_learning"], ("food_container",))
    legend(axis, **above())
    return drawn


@styled
def stimulus_weights(runs: Runs) -> Figure:
    drawn, axes = figure(1, 2, sharey=True)
    for axis, robot in zip(axes, ("learning", "no_burst_threshold"), strict=True):
        touch_weights(axis, runs[f"secondary_stimulus/{robot}"], ("food_container", "empty_container"))
        axis.set(title="burst threshold" if robot == "learning" else "no burst threshold")
    axes[1].set(ylabel="")
    legend(drawn, loc="outside lower center", ncols=2)
    return drawn


@styled
def orbit_distance(runs: Runs) -> Figure:
    drawn, axis = figure()
    for robot in ("learning_disabled", "positive_baseline", "learning"):
        run = runs[f"orbit/{robot}"]
        axis.plot(run.time, run.series["nearest_item"][:, 0], color=ROBOTS[robot], label=spoken(robot))
    run = runs["orbit/learning"]
    food_taken(axis, run, "food, by the one that learns")
    mark(axis, published()["escaped"]["orbit"]["learning"]["mean"], "published mean escape", vertical=True)
    escape = escapes(run)
    escape, look = escape[np.isfinite(escape)], {"color": ROBOTS["learning"], "ms": 9, "label": "escapes in all trials"}
    axis.plot(escape, np.full(len(escape), 0.5), "|", **look)
    axis.set(xlabel=style.TIME, ylabel="Distance to the item (cm)", xlim=(0, min(20, run.time[-1])), ylim=(0, None))
    legend(axis, **above())
    return drawn


def one_side(
    axis: Axes, run: Run, trial: int = 0, kind: str = "weight", sense: str = "food", side: str = "left"
) -> None:
    """From the sensor of one side to both motors in one trial."""
    other = {"left": "right", "right": "left"}[side]
    values, looks = {}, {}
    for motor, colour, name in ((other, ATTRACTION, "attraction"), (side, AVOIDANCE, "avoidance")):
        projection = f"{side}_{sense}_to_{motor}_motor"
        values[projection] = run.of_projection(kind, projection)[:, trial]
        looks[projection] = {"color": colour, "label": f"{spoken(projection)} ({name})"}
    label = style.MEAN_WEIGHT if kind == "weight" else style.MEAN_ELIGIBILITY
    charts.courses(axis, run.time, values, label, **looks)


def food_taken(axis: Axes, run: Run, label: str = "food", trial: int = 0) -> None:
    """When a trial took food."""
    charts.rewards(axis, run.time, run.series["collection_rate"][:, trial] > 0, label)


@styled
def orbit_weights(runs: Runs) -> Figure:
    drawn, axes = figure(1, 2, sharey=True)
    for axis, robot in zip(axes, ("learning", "positive_baseline"), strict=True):
        run = runs[f"orbit/{robot}"]
        one_side(axis, run)
        axis.plot(
            run.time,
            run.of_projection("weight", "right_food_to_left_motor")[:, 0],
            "--",
            color=ATTRACTION,
            label="right food to left motor",
        )
        food_taken(axis, run)
        axis.set(ylim=(0, 3.9))
        axis.set_title(spoken(robot), color=ROBOTS[robot])
    axes[1].set(ylabel="")
    legend(drawn, loc="outside lower center", ncols=2)
    return drawn


@styled
def orbit_firing(runs: Runs) -> Figure:
    run = runs["orbit/learning"]
    drawn, axes = figure(2, 1, height=4.2, sharex=True)
    for axis, kind in zip(axes, ("food", "motor"), strict=True):
        for side, colour in zip(SIDES, (LEFT, RIGHT), strict=True):
            values = smooth(run.firing_rate(f"{side}_{kind}"), window_of(run, SMOOTH)[0])[:, 0]
            axis.plot(run.time, values, color=colour, label=f"{side} {kind}")
        mark(axis, float(escapes(run)[0]), "leaves its orbit", vertical=True)
        axis.set(ylabel=style.FIRING, ylim=(0, None))
        legend(axis, loc="upper right")
    axes[1].set(xlabel=style.TIME, xlim=(0, min(20, run.time[-1])))
    return drawn


@styled
def first_eligibility(runs: Runs) -> Figure:
    run = runs["first_eligibility"]
    drawn, axis = figure()
    one_side(axis, run, kind="eligibility")
    food_taken(axis, run)
    legend(axis, **above(2))
    return drawn


@styled
def single_trial(runs: Runs) -> Figure:
    run = runs["single_trial"]
    drawn, axes = figure(2, 1, height=4.6, sharex=True)
    width, meaning = window_of(run, run.time[-1] / 100)
    for motor, colour, name in (("right", ATTRACTION, "attraction"), ("left", AVOIDANCE, "avoidance")):
        values = run.of_projection("eligibility", f"left_food_to_{motor}_motor")[:, 0]
        axes[0].plot(run.time, values, color=colour, alpha=0.35, linewidth=0.6, label=f"{name}, every sample")
        axes[0].plot(run.time, smooth(values, width), color=colour, label=f"{name}, mean of {meaning}")
    axes[0].set(ylabel=style.MEAN_ELIGIBILITY.replace(" (", "\n("))
    legend(axes[0], **above(2))
    one_side(axes[1], run)
    legend(axes[1], **above(2))
    mark(axes[1], published()["said"]["attraction_settled"], "published: settled", vertical=True)
    return drawn


@styled
def weight_matrix(runs: Runs) -> Figure:
    run = runs["food_attraction/learning"]
    rows = [[run.weights[f"{side}_food_to_{motor}_motor"][0].T for side in SIDES] for motor in SIDES]
    matrix = np.block(rows)  # motors down, sensors across
    drawn, axis = figure(width=5.6, height=5.2)
    sizes = {kind: {f"{side}_{kind}": len(matrix) // 2 for side in SIDES} for kind in ("food", "motor")}
    charts.weight_matrix(axis, matrix, sizes["food"], sizes["motor"], run.config["network"]["plasticity"]["weight_max"])
    return drawn


@styled
def poison_eligibility(runs: Runs) -> Figure:
    run = runs["poison_switch"]
    drawn, axis = figure()
    one_side(axis, run, kind="eligibility")
    taken, poison = run.series["collection_rate"][:, 0] > 0, run.time > switch(run)
    taken[0] = False  # since the start
    charts.rewards(axis, run.time, taken & ~poison)
    charts.rewards(axis, run.time, taken & poison, "poison", color=POISON)
    axis.set(xlim=(run.time[1], run.time[-1]))
    mark(axis, switch(run), "food turns to poison", vertical=True)
    legend(axis, **above(2))
    return drawn


@styled
def poison_weights(runs: Runs) -> Figure:
    run = runs["food_poison/learning"]
    drawn, axes = figure(1, 2)
    for axis, close in zip(axes, (False, True), strict=True):
        for response, colour in (("attraction", ATTRACTION), ("avoidance", AVOIDANCE)):
            band(axis, run.time, taxis(run, "weight", "food", response), colour, response)
        axis.set(xlabel=style.TIME, ylabel=style.MEAN_WEIGHT, ylim=(0, 3.6), xlim=(0, run.time[-1]))
        if close:
            late = run.time > switch(run) + 0.1 * (run.time[-1] - switch(run))
            top = max(float(taxis(run, "weight", "food", r)[late].mean(1).max()) for r in ("attraction", "avoidance"))
            axis.set(title="close-up", xlim=(switch(run), run.time[-1]), ylim=(0, 2.5 * top), ylabel="")
        else:
            mark(axis, switch(run), "poison", vertical=True)
            axis.set(title="mean over trials")
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn


def leads(run: Run) -> np.ndarray:
    """By how much (mV) container attraction exceeds what counts as learnt at the end, of each side and trial [2, B]."""
    ends = [
        [run.of_projection("weight", name)[-1] for name in pathways("container", response)]
        for response in ("attraction", "avoidance")
    ]
    attraction, avoidance = np.array(ends)
    return np.asarray(np.minimum(attraction - STRENGTH, attraction - LEAD * avoidance))


def failure(runs: Runs) -> tuple[str, int, str] | None:
    """The first trial that did not learn to be attracted by containers: its run, its row, and the side that fails most.

    Of fixed container dopamine or else of dual learning.
    """
    for name in ("secondary_behaviour/fixed_container_dopamine", "dual_learning/learning"):
        found = leads(runs[name])
        failed = np.flatnonzero((runs[name].trials["correct"] == 0) & (found.min(0) <= 0))
        if len(failed):
            return name, int(failed[0]), SIDES[int(found[:, failed[0]].argmin())]
    return None


@styled
def failing_trial(runs: Runs) -> Figure | None:
    found = failure(runs)
    if found is None:
        return None
    name, row, side = found
    drawn, axis = figure()
    one_side(axis, runs[name], row, sense="container", side=side)
    avoidance = runs[name].of_projection("weight", f"{side}_container_to_{side}_motor")[:, row]
    axis.plot(runs[name].time, LEAD * avoidance, ":", color=OTHER, linewidth=1.0, label=f"{LEAD:g} times avoidance")
    axis.set(ylim=(0, 3.6))
    mark(axis, STRENGTH, "attraction must exceed")
    legend(axis, **above(2))
    return drawn


@styled
def dampening(runs: Runs) -> Figure:
    """Food taxis weights while their mean is at its limit."""
    run = runs["dampening"]
    seen = dampened(run)
    trial = int(seen.falls.sum(0).argmax())
    drawn, axis = figure()
    for values, colour, name in (
        (seen.attraction, ATTRACTION, "attraction"),
        (seen.avoidance, AVOIDANCE, "avoidance"),
        (seen.mean, OTHER, "mean of the set"),
    ):
        axis.plot(run.time, values[:, trial], color=colour, linewidth=1.2, label=name)
    falls = seen.falls[:, trial]
    axis.plot(run.time[falls], np.full(falls.sum(), seen.limit + 0.03), "v", color="black", ms=4, label="all fall")
    axis.axhline(seen.limit, **PUBLISHED, label="limit of the mean")
    food_taken(axis, run, trial=trial)
    axis.set(xlabel=style.TIME, ylabel=style.MEAN_WEIGHT, xlim=(0, run.time[-1]))
    legend(axis, **above())
    return drawn


@styled
def window(seen: Window) -> Figure:
    drawn, axes = figure(1, 2, height=3.0)
    times, change, eligibility = seen.times, seen.change, seen.eligibility
    for part, colour, label in ((change >= 0, ATTRACTION, "potentiation"), (change < 0, AVOIDANCE, "depression")):
        axes[0].plot(times[part], change[part], color=colour, label=label)
    axes[0].set(xlabel="Postsynaptic after presynaptic spike (ms)", ylabel=f"Change of {style.ELIGIBILITY.lower()}")
    axes[0].set(ylabel="Change of eligibility (mV/(µM ms))", title="STDP window")
    legend(axes[0])
    axes[1].plot(np.arange(len(eligibility)) / 1000, eligibility, color=ATTRACTION)
    axes[1].set(
        xlabel=style.TIME, ylabel=style.ELIGIBILITY, title=f"after one pair, {seen.gap} ms apart", ylim=(0, None)
    )
    return drawn


@styled
def encoding(seen: tuple[np.ndarray, np.ndarray]) -> Figure:
    """Values of a sensor [T] and the spikes [T, n] that they make, by ms."""
    values, spikes = seen
    drawn, axes = figure(2, 1, height=3.6, sharex=True, height_ratios=(1, 3))
    axes[0].plot(np.arange(len(values)) / 1000, values, color=OTHER)
    axes[0].set(ylabel="Sensor value")
    step, neuron = spikes.nonzero()
    charts.raster(axes[1], step / 1000, neuron)
    axes[1].set(ylim=(-1, spikes.shape[1]), xlim=(0, len(values) / 1000), title="left food neurons")
    return drawn


def unrolled(run: Run, trial: int = 0) -> np.ndarray:
    """The robot's path without the jumps of the torus, [T, 2], cm."""
    side = run.config["world"]["side"]
    position = run.series["position"][:, trial].astype(float)
    step = np.diff(position, axis=0, prepend=position[:1])
    return np.asarray(position[0] + (step - side * np.round(step / side)).cumsum(0))


@styled
def walk_path(runs: Runs) -> Figure:
    path = unrolled(runs["random_walk"])
    drawn, axis = figure(width=4.6, height=4.2)
    axis.plot(*path.T, color=ROBOTS["random_walk"], linewidth=1.0)
    axis.plot(*path[0], "o", color=LEFT, label="start")
    axis.plot(*path[-1], "s", color=RIGHT, label=f"after {length(runs['random_walk'])}")
    axis.set(xlabel=style.X, ylabel=style.Y, aspect="equal")
    legend(axis)
    return drawn


@styled
def orbit_path(runs: Runs) -> Figure:
    drawn, axes = figure(1, 2, width=6.4, height=3.6)
    for axis, robot in zip(axes, ("learning_disabled", "learning"), strict=True):
        run = runs[f"orbit/{robot}"]
        seconds = min(10.0 if robot == "learning" else 3.0, run.config["seconds"])
        path = unrolled(run)[run.time <= seconds]
        axis.plot(*path.T, ".-", color=ROBOTS[robot], ms=3, linewidth=0.7, label=spoken(robot))
        centre = path[:14].mean(0)  # a whole round of the orbit
        radius = run.config["world"]["kinds"]["food"]["radius"]
        axis.add_patch(Circle((centre[0], centre[1]), radius, color=FOOD, label="food"))
        axis.set(xlabel=style.X, ylabel=style.Y, aspect="equal", title=f"{spoken(robot)}, {seconds:g} s")
    legend(drawn, loc="outside lower center", ncols=3)
    return drawn


@styled
def environments(worlds: Mapping[str, World]) -> Figure:
    drawn, axes = figure(1, 3, width=7.2, height=2.8)
    for axis, (title, world) in zip(axes, worlds.items(), strict=True):
        draw_world(axis, world)
        axis.set(title=title, ylabel=style.Y if axis is axes[0] else "")
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn


@styled
def coincidence(found: Coincidence | None) -> Figure | None:
    """Spikes, eligibility, dopamine and weight of one synapse."""
    if found is None:
        return None
    drawn, axes = figure(4, 1, height=5.4, sharex=True, height_ratios=(1, 2, 2, 2))
    time = (found.start + np.arange(len(found.pre))) / 1000
    for row, (spikes, colour) in enumerate(((found.post, GROUPS[1]), (found.pre, GROUPS[0]))):
        axes[0].plot(time[spikes > 0], np.full(int(spikes.sum()), row), "|", color=colour, ms=12, mew=1.6)
    axes[0].set(yticks=(0, 1), yticklabels=("dopaminergic", "touch"), ylim=(-0.6, 1.6), title="spikes")
    for axis, values, label, colour in (
        (axes[1], found.eligibility, style.ELIGIBILITY.replace(" (", "\n("), OTHER),
        (axes[2], found.dopamine, style.LEVEL, DOPAMINE),
        (axes[3], found.weight, style.WEIGHT, OTHER),
    ):
        axis.plot(time, values, color=colour)
        axis.set(ylabel=label)
    for axis in axes:
        charts.rewards(axis, time, np.isin(np.arange(len(time)), found.food))
    axes[3].set(xlabel=style.TIME, xlim=(time[0], time[-1]))
    if len(found.food):
        legend(axes[3])
    return drawn
