"""Pictures of a replayed trial: the robot on its way, the spikes, and the credit that dopamine gave."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from PIL import Image

from snnrl.drawing import charts, style
from snnrl.drawing.palette import ATTRACTION, AVOIDANCE, CONTAINER, DOPAMINE, EDGE, FOOD, INK, OTHER, POISON
from snnrl.drawing.pictures import draw_world, spans
from snnrl.drawing.style import STYLE, figure, legend, spoken, styled
from snnrl.replay.trial import Recording
from snnrl.schema import FOOD as SCORED

FRAMES = 220  # of an animation at most
SHORTEST, LONGEST = 40, 140  # ms that a frame is shown
RECENT = 10_000  # ms of the robot's path
TOUCHED = {SCORED: FOOD, "food_container": CONTAINER, "empty_container": EDGE, "poison": POISON}


def animate(recording: Recording, folder: Path) -> None:
    """Write replay.gif, and replay.mp4 where ffmpeg is on the PATH."""
    ticks = len(recording.scenes)
    every = -(-ticks // FRAMES)
    shown = int(np.clip(every * recording.tick, SHORTEST, LONGEST))
    frames = list(_frames(recording, range(0, ticks, every)))
    # one palette for all, no dithering: what does not move is stored once
    palette = frames[len(frames) // 2].quantize(64, dither=Image.Dither.NONE)
    first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    path = folder / "replay.gif"
    first.save(path, save_all=True, append_images=rest, duration=shown, loop=0, optimize=False)
    if shutil.which("ffmpeg"):
        _film(frames, 1000 / shown, folder / "replay.mp4")


def _film(frames: list[Image.Image], rate: float, path: Path) -> None:
    size = f"{frames[0].width}x{frames[0].height}"
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", f"{rate:g}", "-i", "-")
    command = ("ffmpeg", "-loglevel", "error", "-y", *raw, "-pix_fmt", "yuv420p", str(path))
    subprocess.run(command, input=b"".join(frame.tobytes() for frame in frames), check=True)


def _frames(recording: Recording, ticks: range) -> Iterator[Image.Image]:
    """One picture (RGB) for each of those ticks; the robot glows with dopamine."""
    world, tick, start = recording.simulation.situation.world, recording.tick, recording.start
    has_dopamine = len(recording.levels) > 0
    with mpl.rc_context({**STYLE, "figure.constrained_layout.use": False}):
        drawn = Figure(figsize=(4.8, 5.6 if has_dopamine else 4.8), dpi=100)
        arena = drawn.add_axes((0.115, 0.295, 0.86, 0.66) if has_dopamine else (0.115, 0.1, 0.86, 0.85))
        strip = drawn.add_axes((0.115, 0.085, 0.86, 0.1)) if has_dopamine else None
    canvas = FigureCanvasAgg(drawn)
    peak = float(np.abs(recording.levels).max()) if has_dopamine else 1.0
    cursor = None
    if strip is not None:
        now = (start + np.arange(len(recording.levels))) / 1000
        strip.plot(now, recording.levels, color=DOPAMINE, linewidth=0.8)
        cursor = strip.axvline(start / 1000, color="black", linewidth=1.0)
        strip.set(xlim=(start / 1000, recording.end / 1000), xlabel=style.TIME)
        strip.set_title(style.LEVEL, fontsize=8, pad=3)
    way = np.array([scene["position"][0].tolist() for scene in recording.scenes])
    eaten = recording.touches[SCORED].cumsum() if SCORED in recording.touches else np.zeros(len(way), int)
    for k in ticks:
        world.load_state_dict(recording.scenes[k])
        arena.clear()
        draw_world(arena, world, start + k * tick)
        _draw_path(arena, way[max(0, k + 1 - RECENT // tick) : k + 1], world.config.side)
        since = max(0, k + 1 - ticks.step) * tick  # the last frame
        level = recording.levels[since : (k + 1) * tick].max(initial=0.0)
        glow = min(1.0, np.sqrt(level / peak))
        x, y = world.position[0].tolist()
        arena.plot(x, y, "o", color=DOPAMINE, alpha=glow, ms=22, mew=0, zorder=1)
        at = (start + k * tick) / 1000
        arena.set_title(f"{at:.1f} s", loc="left", fontsize=10, family="DejaVu Sans Mono")
        what = "poison" if recording.poison[k] else "food"
        arena.set_title(f"trial {recording.trial}    {what} taken {eaten[k]}", loc="right", fontsize=9, weight="normal")
        if cursor is not None:
            cursor.set_xdata([at, at])
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _draw_path(axis: Axes, way: np.ndarray, side: float) -> None:
    """The path [n, 2] (cm), fading into the past; not drawn where it leaves one side and enters the other."""
    if len(way) < 2:
        return
    steps = np.stack([way[:-1], way[1:]], 1)
    inside = (np.abs(np.diff(steps, axis=1)) < 0.5 * side).all((1, 2))
    alpha = np.linspace(0.05, 0.9, len(steps))
    lines = LineCollection(list(steps[inside]), colors=INK, linewidths=1.4, alpha=alpha[inside], zorder=1.5)
    axis.add_collection(lines, autolim=False)


@styled
def draw_raster(recording: Recording) -> Figure:
    """All spikes by group, with what was touched, dopamine, and what the motors chose."""
    network = recording.simulation.network
    heights = (0.03 * network.size + 0.6, 1.0, 0.7)
    drawn, axes = figure(3, 1, width=11, height=sum(heights) + 0.6, sharex=True, height_ratios=heights)
    spikes, level, wheels = axes
    charts.raster(spikes, recording.time / 1000, recording.neuron, spans(network))
    spikes.set(xlabel="")
    if len(recording.levels):
        level.plot((recording.start + np.arange(len(recording.levels))) / 1000, recording.levels, color=DOPAMINE, lw=1)
    level.set(ylabel=style.LEVEL)
    ticks = (recording.start + recording.tick * np.arange(len(recording.wheels) + 1)) / 1000
    wheels.stairs(-recording.wheels, ticks, color=OTHER, linewidth=0.8, baseline=None)
    wheels.set(yticks=(-1, 0, 1), yticklabels=("right", "straight", "left"), ylim=(-1.4, 1.4), ylabel="Turn")
    wheels.set(xlabel=style.TIME, xlim=(ticks[0], ticks[-1]))
    _mark_touches(recording, list(axes), ticks)
    return drawn


def _mark_touches(recording: Recording, axes: list[Axes], ticks: np.ndarray) -> None:
    for name, touches in recording.touches.items():
        poison, colour = recording.poison & (name == SCORED), TOUCHED.get(name, OTHER)
        for bad in (False, True):
            at = ticks[:-1][(touches > 0) & (poison == bad)]
            label = ("poison" if bad else spoken(name)) + " touched"
            style: Any = {"color": POISON if bad else colour, "linewidth": 1.4, "alpha": 0.7, "zorder": 0}
            for axis in axes:
                lines = axis.vlines(at, 0, 1, transform=axis.get_xaxis_transform(), **style)
                lines.set_label(label if len(at) else "")
    handles, labels = axes[0].get_legend_handles_labels()
    if handles:
        axes[0].legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.1)


@styled
def draw_credit(recording: Recording) -> Figure | None:
    """What each transient did to each projection, and the two synapses that the largest changed most, explained."""
    credit = recording.credit
    if not credit.rewards or not credit.synapses:
        return None
    number = int(np.argmax([np.abs(reward.change).sum() for reward in credit.rewards]))
    reward = credit.rewards[number]
    drawn = Figure(figsize=(10, 8.6))
    top, bottom = np.asarray(drawn.subfigures(2, 1, height_ratios=(1, 1.5)))
    table, cloud = top.subplots(1, 2, width_ratios=(1.9, 1))
    axes = bottom.subplots(3, 2, sharex="col", height_ratios=(0.7, 1.4, 1))
    _draw_table(table, recording, number)
    _draw_cloud(cloud, recording, number)
    for column, k in enumerate((int(reward.change.argmax()), int(reward.change.argmin()))):
        _draw_synapse(axes[:, column], recording, number, k)
    for row in axes:
        row[1].set(ylabel="")
    bottom.legend(handles=_marks(), loc="outside lower center", ncols=6)
    return drawn


def _marks() -> list[Line2D]:
    """What the marks of `_draw_synapse` mean."""
    pairs = {"pair that potentiates": ATTRACTION, "pair that depresses": AVOIDANCE}
    return [
        Line2D([], [], color=INK, marker="|", linestyle="none", ms=9, mew=1.2, label="spike"),
        *(Line2D([], [], color=colour, linewidth=1.0, label=label) for label, colour in pairs.items()),
        Line2D([], [], color=INK, label="eligibility"),
        Line2D([], [], color=DOPAMINE, label="dopamine"),
        Line2D([], [], color=DOPAMINE, marker="o", linewidth=0.8, alpha=0.7, label="reward"),
    ]


def _colour_of(projection: Any) -> str:
    if "attraction" in projection.role:
        return ATTRACTION
    return AVOIDANCE if "avoidance" in projection.role else OTHER


def _draw_table(axis: Axes, recording: Recording, number: int) -> None:
    """Mean change of weight by projection and reward."""
    credit = recording.credit
    names = list(dict.fromkeys(synapse.projection for synapse in credit.synapses))
    of = np.array([names.index(synapse.projection) for synapse in credit.synapses])
    sizes = np.bincount(of)
    means = np.stack([np.bincount(of, reward.change) / sizes for reward in credit.rewards], 1)
    limit = float(np.abs(means).max()) or 1.0
    axis.imshow(means, cmap="PuOr_r", vmin=-limit, vmax=limit, aspect="auto")
    axis.add_patch(Rectangle((number - 0.5, -0.5), 1, len(names), fill=False, ec="black", lw=1.5, clip_on=False))
    if means.shape[1] <= 18:
        for (row, column), value in np.ndenumerate(means):
            shade = "white" if abs(value) > 0.6 * limit else "black"
            axis.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=6.5, color=shade)
    causes = (reward.cause.replace("+", ",\n").replace("_", " ") for reward in credit.rewards)
    labels = [
        f"{k}\n{reward.start / 1000:.1f} s\n{cause}"
        for k, (reward, cause) in enumerate(zip(credit.rewards, causes, strict=True))
    ]
    every = -(-means.shape[1] // 9)
    axis.set(xticks=range(0, means.shape[1], every), xticklabels=labels[::every], yticks=range(len(names)))
    axis.set_yticklabels([name.replace("_to_", " \u2192 ").replace("_", " ") for name in names])
    axis.tick_params(labelsize=7, length=0)
    axis.grid(False)
    axis.set(title="mean change of weight at each reward (mV)")


def _draw_cloud(axis: Axes, recording: Recording, number: int) -> None:
    """Every synapse: eligibility at the reward against the change that followed."""
    credit, reward = recording.credit, recording.credit.rewards[number]
    projections = recording.simulation.network.projections
    colours = np.array([_colour_of(projections[synapse.projection]) for synapse in credit.synapses])
    for colour, label in ((ATTRACTION, "attraction"), (AVOIDANCE, "avoidance"), (OTHER, "other")):
        if (colours == colour).any():
            of = colours == colour
            axis.plot(reward.eligibility[of], reward.change[of], ".", color=colour, ms=3, alpha=0.5, label=label)
    axis.axhline(0, color="#999999", linewidth=0.6)
    axis.axvline(0, color="#999999", linewidth=0.6)
    axis.set(xlabel="Eligibility at the reward (mV/(µM ms))", ylabel="Change of weight (mV)")
    axis.set(title=f"reward {number}: all synapses")
    legend(axis, markerscale=3)


def _draw_synapse(axes: Any, recording: Recording, number: int, k: int, back: int = 1500) -> None:
    """Spikes, pairs and eligibility of one synapse until a reward, and its weight with dopamine."""
    credit, reward = recording.credit, recording.credit.rewards[number]
    synapse, pairs = credit.synapses[k], credit.pairs[k]
    low, high = max(recording.start, reward.start - back), reward.end
    spikes, trace, level = axes
    for row, neuron in enumerate(reversed(synapse.ends)):
        train = credit.trains[neuron]
        train = train[(train >= low) & (train < high)]
        spikes.plot(train / 1000, np.full(len(train), row), "|", color=INK, ms=9, mew=1.2)
    decayed, rest = credit.eligibility(k, reward.start)
    largest = max(float(np.abs(decayed).max(initial=0.0)), 1e-12)
    for pre, post, value in zip(pairs.pre, pairs.post, decayed, strict=False):
        if max(pre, post) >= low:
            colour, strength = (ATTRACTION if value > 0 else AVOIDANCE), min(1.0, 0.08 + abs(value) / largest)
            spikes.plot([pre / 1000, post / 1000], [0.8, 0.2], color=colour, alpha=strength, linewidth=1.0)
    at = np.arange(low, high)
    eligibility = [parts.sum() + left for parts, left in (credit.eligibility(k, t) for t in at.tolist())]
    trace.plot(at / 1000, eligibility, color=INK)
    trace.axhline(0, color="#999999", linewidth=0.6)
    trace.plot(reward.start / 1000, reward.eligibility[k], "o", color=DOPAMINE, ms=5)
    text = f"{reward.eligibility[k]:+.3f} = {np.sum(decayed > 0)} gains {decayed[decayed > 0].sum():+.3f}, "
    text += f"{np.sum(decayed < 0)} losses {decayed[decayed < 0].sum():+.3f}"
    text += f", from before {rest:+.3f}" if abs(rest) >= 0.0005 else ""
    trace.annotate(text, (0.01, 0.97), xycoords="axes fraction", va="top", fontsize=7)
    level.plot(at / 1000, recording.levels[at - recording.start], color=DOPAMINE)
    text = f"weight {reward.before[k]:.3f} \u2192 {reward.after[k]:.3f} mV: driven {reward.driven[k]:+.3f}"
    for name in ("clipped", "dampened"):
        if abs(getattr(reward, name)[k]) >= 0.0005:
            text += f", {name} {getattr(reward, name)[k]:+.3f}"
    level.annotate(text, (0.01, 0.97), xycoords="axes fraction", va="top", fontsize=7)
    for axis in (trace, level):
        bottom, top = axis.get_ylim()
        axis.set_ylim(bottom, top + 0.2 * (top - bottom))  # room for the text
    for axis in axes:
        axis.axvline(reward.start / 1000, color=DOPAMINE, linewidth=0.8, alpha=0.7)
    kind = "gained" if reward.change[k] > 0 else "lost" if reward.change[k] < 0 else "unchanged"
    name = synapse.projection.replace("_to_", " \u2192 ").replace("_", " ")
    spikes.set(title=f"{kind} most: {name}, {synapse.pre} \u2192 {synapse.post}", yticks=(0, 1), ylim=(-0.5, 1.5))
    spikes.set_yticklabels(("post", "pre"))
    spikes.grid(False)
    trace.set(ylabel=style.ELIGIBILITY)
    level.set(ylabel=style.LEVEL, xlabel=style.TIME, xlim=(low / 1000, high / 1000))
