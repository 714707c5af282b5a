"""Pictures of a running simulation: the arena, who fires, the weights."""

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
from snnrl.drawing.style import CONTAINER, FOOD, OTHER, POISON, figure
from snnrl.model.network import Network
from snnrl.model.synapses import Projection
from snnrl.schema import FOOD as SCORED

ROWS = 1000  # at most, of neurons in a raster or a matrix


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
            style: dict[str, Any] = {"fc": full, "ec": "#999933", "lw": 1}
            if not entered:
                style = {"color": POISON if bad[k] else FOOD if name == SCORED else OTHER}
            axis.add_patch(Circle(tuple(centre), float(kinds.radius[k]), **style))
    x, y = world.position[0].tolist()
    heading = float(world.heading[0])
    axis.plot(x, y, marker=(3, 0, np.degrees(heading) - 90), color="#332288", ms=8)
    axis.grid(False)
    axis.set(xlim=(0, world.config.side), ylim=(0, world.config.side), aspect="equal", xlabel="x (cm)")


def arena(world: World, path: np.ndarray) -> Figure:
    """The world of the first trial, and where its robot has been: `path` [T, 2], cm."""
    drawn, axis = figure(width=4.2, height=4.0)
    jumps = np.abs(np.diff(path, axis=0)).max(1, initial=0.0) > world.config.side / 2  # over the edge of the torus
    broken = np.insert(path, np.flatnonzero(jumps) + 1, np.nan, axis=0)
    axis.plot(*broken.T, color="#332288", linewidth=1.0, alpha=0.6)
    draw_world(axis, world)
    axis.set_ylabel("y (cm)")
    return drawn


def spike_raster(network: Network, fired: np.ndarray, start: float) -> Figure:
    """Who fired in one trial: bool [T, N], the first ms at `start` (s)."""
    drawn, axis = figure(width=6.4, height=4.0)
    step = -(-network.size // ROWS)
    time, neuron = fired[:, ::step].nonzero()
    axis.plot(time, neuron * step, linestyle="", marker="|", color="#332288", ms=2.5, mew=0.8)
    spans = [group.span for group in network.groups.values()]
    for span in spans[1:]:
        axis.axhline(span.start - 0.5, color=OTHER, linewidth=0.4)
    axis.set_yticks([(span.start + span.stop - 1) / 2 for span in spans], list(network.groups))
    axis.set(xlabel=f"ms from {start:.2f} s on", xlim=(0, len(fired)), ylim=(network.size - 0.5, -0.5))
    axis.grid(False)
    return drawn


def weight_matrix(network: Network, projections: Sequence[Projection]) -> Figure | None:
    """Weights (mV) of some projections in the first trial, side by side; None where there is nothing to show."""
    pre = [name for name in network.groups if any(p.pre == name for p in projections)]
    post = [name for name in network.groups if any(p.post == name for p in projections)]
    first = _starts(network, pre), _starts(network, post)
    if not projections or max(first[0][-1], first[1][-1]) > ROWS:
        return None
    matrix = np.full((first[1][-1], first[0][-1]), np.nan)  # post, pre
    for projection in projections:
        n = int((projection.trial == 0).sum())  # of the first trial, whose synapses come first
        row = first[1][post.index(projection.post)] + projection.post_index[:n].cpu().numpy()
        column = first[0][pre.index(projection.pre)] + projection.pre_index[:n].cpu().numpy()
        matrix[row, column] = projection.weight[:n].float().cpu().numpy()
    drawn, axis = figure(width=6.4, height=4.4)
    axis.set_facecolor("#f7e6d0")
    image = axis.imshow(matrix, cmap="Greys", aspect="auto", interpolation="nearest")
    for edges, line in zip(first, (axis.axvline, axis.axhline), strict=True):
        for edge in edges[1:-1]:
            line(edge - 0.5, color="#0072B2", linewidth=0.8)
    middles = [(np.add(edges[1:], edges[:-1]) - 1) / 2 for edges in first]
    axis.set_xticks(middles[0], [name.replace("_", "\n") for name in pre], fontsize=7)
    axis.set_yticks(middles[1], post)
    axis.set(xlabel="from", ylabel="to")
    axis.grid(False)
    drawn.colorbar(image, label="weight (mV); tinted: no synapse")
    return drawn


def _starts(network: Network, names: Sequence[str]) -> list[int]:
    return [0, *np.cumsum([network.groups[name].size for name in names]).tolist()]


def pixels(drawn: Figure) -> np.ndarray:
    """A figure as it looks: uint8 [height, width, 3]; the figure is cleared, which frees its memory at once."""
    canvas = FigureCanvasAgg(drawn)
    canvas.draw()
    shown = np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
    drawn.clear()
    return shown
