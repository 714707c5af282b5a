"""Unlearning what no longer predicts food.

After Chorley and Seth 2011 (Front. Comput. Neurosci. 5:21): conf/network/predicting.yaml, with and without its
inhibition of expected reward. In open loop a container's touch is the cue, food's touch the reward; then the robot.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from snnrl.beyond.course import interval
from snnrl.beyond.page import Page, table
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.drawing import style
from snnrl.drawing.palette import NO_FOOD, ROBOTS
from snnrl.drawing.style import figure, legend, mark, multiples, styled
from snnrl.engines import Engine, make_engine
from snnrl.intervals import wilson
from snnrl.model.network import Network
from snnrl.recording.criteria import correct

DOPAMINERGIC, CUE, OTHER, REWARD = "dopaminergic", "food_container_touch", "empty_container_touch", "food_touch"
LENGTH, AT, DELAY = 3000, 500, 800  # ms: a presentation, until the cue in it, from the cue to the reward
ANSWER = 15  # ms after a pulse in which dopaminergic spikes answer it
AROUND = slice(AT + DELAY - 100, AT + DELAY + 100)  # the time of the reward
PULSE = 40.0  # fires every neuron of a group
SHOWN = 20  # presentations that a response is the mean of

Stage = tuple[
    str, Mapping[str, int], int
]  # a name, or "" if nobody looks; groups and the ms of their pulses; how often
EXPERIMENT = "+experiment=extinction"
CONTROLS = {
    "predicting": (),
    "without inhibition": ("robot=no_expectation",),
    "thesis's network": ("network=food_container",),
}
USUAL = ("dual_learning", "secondary_behaviour", "secondary_stimulus")  # the thesis's experiments with containers
TRAINED, OMITTED, SAMPLES = 160, 200, 70  # presentations with reward, without it, and samples of a robot's life
FELL = 0.2  # of what it was, beyond that of a robot that was never fed: what has come down to this is unlearnt
LEAST = {"response": 0.1, "lead": 0.2, "visits": 0.05}  # beyond that, what has been learnt


def conditioning(trained: int, omitted: int) -> list[Stage]:
    """Cue and reward, then the cue alone, then both again."""
    both, alone = {CUE: AT, REWARD: AT + DELAY}, {CUE: AT}
    return [
        ("first", both, SHOWN),
        ("", both, trained),
        ("trained", both, SHOWN),
        ("omitted", alone, SHOWN),
        ("", alone, omitted),
        ("extinguished", alone, SHOWN),
        ("", both, trained),
        ("again", both, SHOWN),
    ]


def compound(before: int, together: int) -> list[Stage]:
    """Blocking: a second cue joins the first when that has been trained, or has not."""
    first, second = {CUE: AT, REWARD: AT + DELAY}, {CUE: AT, OTHER: AT, REWARD: AT + DELAY}
    return [("", first, before), ("", second, together), ("second cue", {OTHER: AT}, SHOWN)]


def second_order(before: int, together: int) -> list[Stage]:
    """A second cue precedes the first one, without reward, when that has been trained, or has not."""
    chain = {OTHER: AT, CUE: AT + DELAY}
    return [("", {CUE: AT, REWARD: AT + DELAY}, before), ("", chain, together), ("second cue", {OTHER: AT}, SHOWN)]


def responses(network: Network, engine: Engine, stages: Sequence[Stage]) -> dict[str, Tensor]:
    """Spikes of a dopaminergic neuron in each ms of a presentation, by the name of the stage, [LENGTH, B] each."""
    found = {}
    for name, events, times in stages:
        current = torch.zeros(LENGTH, network.trials, network.size, dtype=network.dtype)
        for group, at in events.items():
            current[at, :, network.groups[group].span] = PULSE
        mean = torch.zeros(LENGTH, network.trials)
        raster = torch.zeros(current.shape, dtype=torch.bool) if name else None
        for _ in range(times):
            engine.run_network(network, current, None, raster)
            if raster is not None:
                mean += raster[:, :, network.groups[DOPAMINERGIC].span].float().mean(2) / times
        if name:
            found[name] = mean
    return found


def answer(response: Tensor, at: int) -> Tensor:
    """Spikes of a dopaminergic neuron in answer to a pulse, beyond the tonic ones, [B]."""
    return response[at + 1 : at + 1 + ANSWER].sum(0) - ANSWER * response[:AT].mean(0)


def dip(response: Tensor) -> Tensor:
    """How far the rate around the time of the reward is from the tonic rate, as a fraction of that, [B]."""
    return response[AROUND].mean(0) / response[:AT].mean(0) - 1.0


def told(response: Tensor) -> tuple[Tensor, ...]:
    """Answers at the cue's and the reward's time, and the rate around the latter, [B] each."""
    return answer(response, AT), answer(response, AT + DELAY), dip(response)


def open_loop(overrides: Sequence[str], stages: Sequence[Stage]) -> dict[str, Tensor]:
    """The `responses` of a network of the experiment."""
    config = compose(EXPERIMENT, *overrides)
    return responses(build(config).network, make_engine(config.engine, config.device, config.threads), stages)


def evoked(network: Network, touch: str = CUE) -> Tensor:
    """Spikes of a dopaminergic neuron that touching a container would evoke now, [B]."""
    counts = []
    for pulse in (PULSE, 0.0):
        tried = copy.deepcopy(network)
        current = torch.zeros(1 + ANSWER, network.trials, network.size, dtype=network.dtype)
        current[0, :, network.groups[touch].span] = pulse
        raster = torch.zeros(current.shape, dtype=torch.bool)
        tried.run(current, raster=raster)
        counts.append(raster[:, :, network.groups[DOPAMINERGIC].span].float().mean(2).sum(0))
    return counts[0] - counts[1]


def lead(network: Network) -> Tensor:
    """Mean weight of attraction to containers less that of avoidance (mV), [B]."""
    mean = {name: p.mean_weight() for name, p in network.projections.items() if p.role.startswith("container_")}
    signs = [1 if network.projections[name].role == "container_attraction" else -1 for name in mean]
    return torch.stack([sign * value for sign, value in zip(signs, mean.values(), strict=True)]).sum(0) / 2


def live(overrides: Sequence[str], samples: int) -> dict[str, np.ndarray]:
    """The robot's life: `time` (s) [T], and what is measured in each of T equal parts, [T, B] each."""
    config = compose(EXPERIMENT, *overrides)
    simulation, engine = build(config), make_engine(config.engine, config.device, config.threads)
    network, world = simulation.network, simulation.situation.world
    ticks = round(1000 * config.seconds / simulation.tick / samples)
    series: dict[str, list[Tensor]] = {"time": [], "response": [], "lead": [], "visits": [], "food": []}
    for _ in range(samples):
        before = {kind: world.count(kind).clone() for kind in ("food_container", "food")}
        simulation.run(engine, ticks)
        passed = ticks * simulation.tick / 1000
        series["time"].append(torch.tensor(simulation.seconds))
        series["response"].append(evoked(network))
        series["lead"].append(lead(network))
        series["visits"].append((world.count("food_container") - before["food_container"]) / passed)
        series["food"].append((world.count("food") - before["food"]) / passed)
    return {name: torch.stack(values).double().numpy() for name, values in series.items()}


def share(which: np.ndarray) -> str:
    """A share of trials and its interval, of bool [n]."""
    if not len(which):
        return "of none"
    low, high = wilson(float(which.mean()), len(which))
    return f"{which.sum()} of {len(which)} [{100 * low:.0f}, {100 * high:.0f} %]"


def open_loop_table(found: Mapping[str, Mapping[str, Tensor]]) -> str:
    """Responses by network and stage."""
    rows = [
        [
            network,
            stage,
            *(interval(answer(response, at).numpy(), 2) for at in (AT, AT + DELAY)),
            interval(dip(response).numpy(), 2),
        ]
        for network, stages in found.items()
        for stage, response in stages.items()
    ]
    return table(["network", "20 presentations", "answer to the cue", "at the reward's time", "rate around it"], rows)


def second_cue_table(found: Mapping[str, Mapping[str, Tensor]]) -> str:
    """The answer to the second cue, by what was done."""
    rows = [[done, interval(answer(stages["second cue"], AT).numpy(), 2)] for done, stages in found.items()]
    return table(["before the second cue is shown alone", "answer to it"], rows)


def periods(series: Mapping[str, np.ndarray], gone: float, back: float) -> dict[str, np.ndarray]:
    """Samples of the last fifth of the time with food, of that without, and of that after its return; bool [T] each."""
    time, end = series["time"], float(series["time"][-1])
    bounds = {"with food": (0.0, gone), "without": (gone, back), "food again": (back, end)}
    return {name: (time > high - 0.2 * (high - low)) & (time <= high) for name, (low, high) in bounds.items()}


def lives_table(
    lives: Mapping[str, Mapping[str, np.ndarray]],
    never: Mapping[str, Mapping[str, np.ndarray]],
    gone: float,
    back: float,
) -> str:
    """What becomes of the response, of attraction and of visits, by robot.

    Hunger alone gives weights a balance above zero, so what has been learnt, and is left of it, is what is beyond the
    mean of robots which were `never` fed, as old as the others at the end without food. Shares are of the trials that
    had learnt.
    """
    rows = []
    for robot, series in lives.items():
        parts = periods(series, gone, back)
        unfed = never[robot]["time"] > back - 0.2 * (back - gone)
        for name, least in LEAST.items():
            floor = float(never[robot][name][unfed].mean())
            learnt, unlearnt, again = (series[name][part].mean(0) - floor for part in parts.values())
            had = learnt > least
            means = [interval(floor + v[had], 2) if had.sum() > 1 else "too few" for v in (learnt, unlearnt, again)]
            fell = unlearnt[had] <= FELL * learnt[had]
            returned = again[had] >= 0.5 * learnt[had]
            rows.append([robot, name, f"{floor:.2f}", share(had), *means, share(fell), share(returned)])
    head = [
        "robot",
        "",
        "never fed",
        "had learnt",
        "with food",
        "without",
        "food again",
        "fell by 80 %",
        "came back to half",
    ]
    return table(head, rows)


def usual_table(overrides: Sequence[str], part: float) -> str:
    """What the thesis's own experiments come to with the network that predicts, and with the plain one."""
    rows = []
    for name in USUAL:
        for network in ("predicting", "food_container"):
            config = compose(f"+experiment={name}", f"network={network}", *overrides)
            simulation, engine = build(config), make_engine(config.engine, config.device, config.threads)
            simulation.run(engine, round(part * 1000 * config.seconds / simulation.tick))
            rules, trained = config.experiment.correct, simulation.network
            learnt = share(correct(trained, rules).numpy()) if rules else "given"
            food = simulation.situation.world.count("food").double().numpy()
            answers = [interval(evoked(trained, touch).double().numpy(), 2) for touch in (CUE, OTHER)]
            names = (name.replace("_", " "), network.replace("_", " "))
            rows.append([*names, interval(food, 0), learnt, *answers])
    head = ["experiment", "network", "items", "learnt", "answer to a food container", "to an empty one"]
    return table(head, rows)


@styled
def draw(
    found: Mapping[str, Mapping[str, Tensor]], lives: Mapping[str, Mapping[str, np.ndarray]], gone: float, back: float
) -> Figure:
    """Dopaminergic firing around cue and reward, and below it the robots' lives, a row for each quantity."""
    drawn, axes = figure(4, 3, 9.6, 8.4, sharey="row")
    for axis, stage in zip(axes[0], ("first", "trained", "omitted"), strict=True):
        for network, stages in found.items():
            rate = stages[stage].view(-1, 20, stages[stage].shape[1]).mean((1, 2)) * 1000.0
            axis.step(np.arange(len(rate)) * 20 - AT, rate, where="post", color=ROBOTS[network], label=network)
        axis.set(title=f"reward {stage}" if stage == "omitted" else stage, xlabel="Time from the cue (ms)")
        axis.set_xlim(-AT, 2000)
        mark(axis, DELAY, "reward's time", vertical=True)
    axes[0, 0].set(ylabel="Dopaminergic firing (Hz)", ylim=(0.0, None))  # shared, so after all are drawn
    labels = {
        "response": "Answer to a container (spikes)",
        "lead": "Attraction less avoidance (mV)",
        "visits": "Containers entered (1/s)",
    }
    for row, (name, label) in zip(axes[1:], labels.items(), strict=True):
        multiples(row, {robot: (series["time"], series[name]) for robot, series in lives.items()})
        for axis in row:
            axis.axvspan(gone, back, color=NO_FOOD, zorder=0, label="no food")
            axis.set(xlabel=style.TIME if name == "visits" else "")
        row[0].set_ylabel(label)
    legend(drawn, loc="outside lower center", ncols=4)
    return drawn


def make(overrides: Sequence[str], part: float = 1.0) -> Page:
    """All of it; `part` of the presentations, and of a robot's life."""
    trained, omitted, samples = (max(1, round(part * whole)) for whole in (TRAINED, OMITTED, SAMPLES))
    both = {name: CONTROLS[name] for name in ("predicting", "without inhibition")}
    found = {name: open_loop([*overrides, *control], conditioning(trained, omitted)) for name, control in both.items()}
    others = {
        f"{name}: {done}": open_loop([*overrides, *control], stages)
        for name, control in both.items()
        for done, stages in {
            "both cues and reward": compound(0, trained // 2),
            "first cue and reward; then both cues and reward": compound(trained, trained // 2),
            "second cue, then first cue": second_order(0, SHOWN),
            "first cue and reward; then second cue, then first cue": second_order(trained, SHOWN),
        }.items()
    }
    usual = compose(EXPERIMENT, *overrides)
    food = usual.body()[1].kinds["food"]
    assert food.absent_from is not None
    assert food.absent_until is not None
    gone, back = part * food.absent_from, part * food.absent_until
    times = (f"seconds={part * usual.seconds:g}", f"world.kinds.food={{absent_from: {gone:g}, absent_until: {back:g}}}")
    lives = {name: live([*overrides, *control, *times], samples) for name, control in CONTROLS.items()}
    unfed = (f"seconds={back:g}", f"world.kinds.food={{absent_from: 0, absent_until: {usual.seconds:g}}}")
    never = {name: live([*overrides, *control, *unfed], samples) for name, control in CONTROLS.items()}
    tables = (open_loop_table(found), second_cue_table(others), lives_table(lives, never, gone, back))
    return Page("\n".join((*tables, usual_table(overrides, part))), draw(found, lives, gone, back))
