"""Pictures of a simulation as it is: the world and where its robot has been, who fires, the weights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from snnrl.body.world import World
from snnrl.body.world.kinds import ENTERED
from snnrl.drawing import charts
from snnrl.drawing.palette import CONTAINER, EDGE, FOOD, INK, OTHER, POISON
from snnrl.drawing.snapshots import copies
from snnrl.drawing.style import figure, legend, spoken, styled
from snnrl.model.network import Network
from snnrl.model.synapses import Projection
from snnrl.schema import FOOD as SCORED

MOST = 1000  # neurons in a matrix


@styled
def arena(world: World, path: np.ndarray, time: int = 0) -> Figure:
    """The world of the first trial at a time (ms), and where its robot has been: `path` [T, 2], cm."""
    drawn, axis = figure(width=6.4, height=4.6)
    draw_world(axis, world, time)
    charts.path(axis, path, world.config.side, INK)
    legend(axis, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return drawn


def draw_world(axis: Axes, world: World, time: int = 0) -> None:
    """The world of the first trial as it is at a time (ms), with what can be entered, what can be taken, and the robot.

    What can be entered is filled where it holds something; what can be taken has the colour of food or of poison.
    """
    kinds, bad = world.kinds, (world.value(torch.tensor(time, device=world.places.device)) < 0).tolist()
    for entered in (True, False):
        for centre, k in zip(world.places[0].tolist(), kinds.kind.tolist(), strict=True):
            if (int(kinds.effect[k]) == ENTERED) != entered:
                continue
            name = kinds.names[k]
            full = CONTAINER if world.config.kinds[name].holds else "none"
            style: dict[str, Any] = {"fc": full, "ec": EDGE, "lw": 1}
            if not entered:
                style = {"color": POISON if bad[k] else FOOD if name == SCORED else OTHER}
            label = "poison" if bad[k] else spoken(name)
            for at in copies(centre[0], centre[1], float(kinds.radius[k]), world.config.side):
                axis.add_patch(Circle(at, float(kinds.radius[k]), label=label, **style))
    x, y = world.position[0].tolist()
    turn = np.degrees(float(world.heading[0])) - 90
    axis.plot(x, y, marker=(3, 0, turn), color=INK, ms=8, linestyle="none", label="robot")
    charts.torus(axis, world.config.side)


@styled
def spike_raster(network: Network, fired: np.ndarray, start: float) -> Figure:
    """Who fired in one trial: bool [T, N], the first ms at `start` (s)."""
    drawn, axis = figure(width=7.2, height=float(np.clip(0.03 * network.size, 2.4, 9.0)))
    step, neuron = fired.nonzero()
    charts.raster(axis, start + step / 1000.0, neuron, spans(network))
    axis.set_xlim(start, start + len(fired) / 1000.0)
    return drawn


def spans(network: Network) -> dict[str, slice]:
    return {name: group.span for name, group in network.groups.items()}


@styled
def weight_matrix(network: Network, projections: Sequence[Projection]) -> Figure | None:
    """Weights (mV) of some projections in the first trial, side by side; None where there is nothing to show.

    What is learnt is black where it is as large as it may be, so that pictures of one run can be compared.
    """
    pre, post = (
        {
            name: group.size
            for name, group in network.groups.items()
            if any(name == getattr(p, end) for p in projections)
        }
        for end in ("pre", "post")
    )
    wide, tall = sum(pre.values()), sum(post.values())
    if not projections or max(wide, tall) > MOST:
        return None
    matrix = np.full((tall, wide), np.nan)
    first_pre, first_post = (dict(zip(of, np.cumsum([0, *of.values()]), strict=False)) for of in (pre, post))
    for projection in projections:
        n = int(projection.count[0])  # of the first trial, whose synapses come first
        row = first_post[projection.post] + projection.post_index[:n].cpu().numpy()
        column = first_pre[projection.pre] + projection.pre_index[:n].cpu().numpy()
        matrix[row, column] = projection.weight[:n].float().cpu().numpy()
    drawn, axis = figure(width=8.0, height=float(np.clip(1.6 + 6.0 * tall / wide, 3.2, 8.0)))
    largest = [float(np.nanmax(matrix, initial=0.0)), *(p.rule.weight_max for p in projections if p.rule)]
    charts.weight_matrix(axis, matrix, pre, post, max(largest))
    return drawn


def pixels(drawn: Figure, dpi: float = 100) -> np.ndarray:
    """A figure as uint8 [height, width, 3]."""
    drawn.set_dpi(dpi)
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
