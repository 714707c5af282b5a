"""The README's moving picture: one robot learns to find containers and the food in them.

    python tools/film.py [--trial 0] [--to docs/images/learning.gif]

Short scenes of a trial of dual learning, from its first seconds to its last; beside them what it has come to by then.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.drawing import style
from snnrl.drawing.palette import ATTRACTION, AVOIDANCE, ROBOTS
from snnrl.drawing.pictures import pixels
from snnrl.drawing.snapshots import square
from snnrl.drawing.style import figure, legend, styled
from snnrl.engines import make_engine
from snnrl.running.schedule import ticks_of
from snnrl.schema import FOOD
from snnrl.simulation import Simulation

SCENES = (0.0, 200.0, 500.0, 1000.0, 2000.0, 4900.0)  # s, when they begin
FRAMES, TICKS = 40, 2  # of a scene; control ticks from one to the next
EVERY = 25.0  # s between two points of the curves
SMOOTH = 8  # points over which the food is averaged
SHOWN, COLOURS = 80, 96  # ms that a frame is shown, of the picture's palette
SIDE = 400  # pixels


@dataclass
class Curves:
    """What a robot has come to: times (s), food so far, mean weights (mV) of its container taxis's two responses."""

    time: list[float] = field(default_factory=lambda: [0.0])
    food: list[int] = field(default_factory=lambda: [0])
    attraction: list[float] = field(default_factory=lambda: [0.0])
    avoidance: list[float] = field(default_factory=lambda: [0.0])

    def add(self, simulation: Simulation[Any]) -> None:
        self.time.append(simulation.seconds)
        self.food.append(int(simulation.situation.world.count(FOOD)[0]))
        for response in ("attraction", "avoidance"):
            projections = simulation.network.projections.values()
            weights = [float(p.mean_weight()[0]) for p in projections if p.role == f"container_{response}"]
            getattr(self, response).append(float(np.mean(weights)))

    def rate(self) -> np.ndarray:
        """Items per minute, a mean over the last SMOOTH points; none at the start."""
        first = np.maximum(np.arange(1, len(self.time)) - SMOOTH, 0)
        food, time = np.array(self.food), np.array(self.time)
        return np.append(0.0, 60.0 * (food[1:] - food[first]) / (time[1:] - time[first]))


def film(trial: int) -> list[Image.Image]:
    """All frames."""
    config = compose("+experiment=dual_learning", "trials=1", f"trial_start={trial}", "threads=1")
    simulation, engine = build(config), make_engine("auto", "cpu", 1)
    world, curves, frames = simulation.situation.world, Curves(), []
    for begin in SCENES:
        while simulation.seconds < begin:
            simulation.run(engine, ticks_of(min(EVERY, begin - simulation.seconds), simulation.tick))
            curves.add(simulation)
        beside, path = _beside(curves, config.seconds), [world.position[0].clone()]
        for _ in range(FRAMES):
            for _ in range(TICKS):
                simulation.run(engine, 1)
                path.append(world.position[0].clone())
            frames.append(_frame(simulation, torch.stack(path).numpy(), beside))
    return frames


def _frame(simulation: Simulation[Any], path: np.ndarray, beside: Image.Image) -> Image.Image:
    """The robot in its world on the left, and what it has come to."""
    arena = Image.fromarray(square(simulation.situation.world, path, int(simulation.network.time), finer=2))
    frame = Image.new("RGB", (SIDE + beside.width, SIDE), "white")
    frame.paste(arena.resize((SIDE, SIDE), Image.Resampling.LANCZOS))
    frame.paste(beside, (SIDE, 0))
    return frame


def _beside(curves: Curves, seconds: float) -> Image.Image:
    return Image.fromarray(pixels(draw(curves, seconds))).crop((0, 0, 380, SIDE))


@styled
def draw(curves: Curves, seconds: float) -> Figure:
    """What a robot has come to, on axes that are as long as its trial (s)."""
    drawn, (food, weight) = figure(2, 1, width=3.8, height=SIDE / 100, sharex=True)
    food.plot(curves.time, curves.rate(), color=ROBOTS["learning"])
    food.set(title=f"after {curves.time[-1]:.0f} s", ylabel="Food (items/min)", ylim=(0, 28))
    weight.plot(curves.time, curves.attraction, color=ATTRACTION, label="towards containers")
    weight.plot(curves.time, curves.avoidance, color=AVOIDANCE, label="away from them")
    weight.set(xlabel=style.TIME, ylabel=style.MEAN_WEIGHT, xlim=(0, seconds), ylim=(0, 3.4))
    legend(weight, loc="upper left")
    for axis in (food, weight):
        axis.plot(curves.time[-1:], axis.lines[0].get_ydata()[-1:], "o", color=axis.lines[0].get_color(), ms=4)
    return drawn


def save(frames: list[Image.Image], path: Path) -> None:
    """Write a GIF that goes on for ever, all frames in the palette of the last one."""
    palette = frames[-1].quantize(COLOURS, dither=Image.Dither.NONE)
    few = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(path, save_all=True, append_images=few[1:], duration=SHOWN, loop=0, optimize=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trial", type=int, default=0, help="its number (default 0)")
    parser.add_argument("--to", type=Path, default=Path("docs/images/learning.gif"))
    options = parser.parse_args()
    with torch.no_grad():
        frames = film(options.trial)
    save(frames, options.to)
    print(f"{options.to}: {len(frames)} frames, {options.to.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
