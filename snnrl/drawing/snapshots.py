"""Pictures of a running simulation: the arena, who fires, the weights.

A run draws them while it goes on, so they are drawn pixel by pixel: a figure of Matplotlib takes many times as long.
All are uint8 [height, width, 3].
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw

from snnrl.body.world import World
from snnrl.body.world.kinds import ENTERED
from snnrl.drawing.palette import CONTAINER, FOOD, OTHER, POISON
from snnrl.model.network import Network
from snnrl.model.synapses import Projection
from snnrl.schema import FOOD as SCORED

ROWS = 1000  # at most, of neurons in a raster or a matrix
ROBOT, INK, TINT = "#332288", (51, 34, 136), (247, 230, 208)
TRAIL, EDGE = "#9988cc", "#999933"  # of the robot, and of what can be entered
SIDE, LEFT, RIGHT, TOP, BOTTOM = 480, 130, 60, 22, 36  # pixels: of the arena; margins
WIDTH = 720  # of what is not the arena


def arena(world: World, path: np.ndarray, time: int = 0) -> np.ndarray:
    """The world of the first trial at a time (ms), and where its robot has been: `path` [T, 2], cm."""
    image = Image.new("RGB", (SIDE, SIDE + BOTTOM), "white")
    image.paste(Image.fromarray(square(world, path, time)))
    ImageDraw.Draw(image).text((4, SIDE + 8), f"{world.config.side:g} cm x {world.config.side:g} cm", "black")
    return np.asarray(image)


def square(world: World, path: np.ndarray, time: int = 0, trial: int = 0, finer: int = 1) -> np.ndarray:
    """The world of a trial at a time (ms) from edge to edge, and where its robot has been: `path` [T, 2], cm.

    What can be entered is filled where it holds something; what can be taken has the colour of food or of poison. It
    is drawn `finer` times as large and made smaller, which smooths it.
    """
    kinds, pixels = world.kinds, SIDE * finer
    scale = pixels / world.config.side
    image = Image.new("RGB", (pixels, pixels), "white")
    draw = ImageDraw.Draw(image)
    points = [(x * scale, pixels - y * scale) for x, y in path.tolist()]
    for (x, y), (u, v) in pairwise(points):
        if max(abs(u - x), abs(v - y)) <= pixels / 2:  # else over the edge of the torus
            draw.line((x, y, u, v), TRAIL, 2 * finer)
    bad = (world.value(torch.tensor(time, device=world.places.device)) < 0).tolist()
    places, of_kind = world.places[trial].tolist(), kinds.kind.tolist()
    radius, effect = kinds.radius.tolist(), kinds.effect.tolist()
    for x, y, k in sorted(((x, y, k) for (x, y), k in zip(places, of_kind, strict=True)), key=lambda o: -effect[o[2]]):
        name, r = kinds.names[k], radius[k] * scale
        style: tuple[Any, ...] = (POISON if bad[k] else FOOD if name == SCORED else OTHER,)
        if effect[k] == ENTERED:
            style = CONTAINER if world.config.kinds[name].holds else None, EDGE, finer
        for u, v in _copies(x * scale, pixels - y * scale, r, pixels):
            draw.ellipse((u - r, v - r, u + r, v + r), *style)
    (x, y), heading = world.position[trial].tolist(), float(world.heading[trial])
    corners = [(r * finer, heading + angle) for r, angle in ((12.0, 0.0), (9.0, 2.5), (9.0, -2.5))]
    draw.polygon([(x * scale + r * np.cos(a), pixels - y * scale - r * np.sin(a)) for r, a in corners], ROBOT)
    draw.rectangle((0, 0, pixels - 1, pixels - 1), None, "#999999", finer)
    return np.asarray(image.reduce(finer))


def _copies(x: float, y: float, r: float, side: float) -> list[tuple[float, float]]:
    """Where a disc shows on a torus: once, or at both edges that it crosses."""
    across = [[at + shift for shift in (0.0, side, -side) if -r < at + shift < side + r] for at in (x, y)]
    return [(u, v) for u in across[0] for v in across[1]]


def spike_raster(network: Network, fired: np.ndarray, start: float) -> np.ndarray:
    """Who fired in one trial: bool [T, N], the first ms at `start` (s)."""
    step = -(-network.size // ROWS)
    shown = fired[:, ::step].T
    shown = shown | np.pad(shown, ((0, 0), (1, 0)))[:, :-1]  # 2 pixels wide
    tall = max(1, 700 // max(1, len(shown)))
    rows = np.repeat(np.where(shown[..., None], np.array(INK, np.uint8), np.uint8(255)), tall, axis=0)
    spans = {name: group.span for name, group in network.groups.items()}
    edges = [span.start / step * tall for span in spans.values()]
    image, draw = _framed(rows, f"{len(fired)} ms from {start:.2f} s on", edges, [])
    for name, span in spans.items():
        _label(draw, name, TOP + (span.start + span.stop) / 2 / step * tall)
    return np.asarray(image)


def weight_matrix(network: Network, projections: Sequence[Projection]) -> np.ndarray | None:
    """Weights (mV) of some projections in the first trial, side by side; None where there is nothing to show."""
    pre = [name for name in network.groups if any(p.pre == name for p in projections)]
    post = [name for name in network.groups if any(p.post == name for p in projections)]
    first = _starts(network, pre), _starts(network, post)
    if not projections or max(first[0][-1], first[1][-1]) > ROWS:
        return None
    matrix = np.full((first[1][-1], first[0][-1]), np.nan)  # post, pre
    for projection in projections:
        n = int(projection.count[0])  # of the first trial, whose synapses come first
        row = first[1][post.index(projection.post)] + projection.post_index[:n].cpu().numpy()
        column = first[0][pre.index(projection.pre)] + projection.pre_index[:n].cpu().numpy()
        matrix[row, column] = projection.weight[:n].float().cpu().numpy()
    least, most = (np.nanmin(matrix), np.nanmax(matrix)) if np.isfinite(matrix).any() else (0.0, 1.0)
    grey = 255 - 255 * np.nan_to_num((matrix - least) / max(most - least, 1e-9), posinf=0.0, neginf=0.0)
    drawn = np.where(
        np.isnan(matrix)[..., None], np.array(TINT, np.uint8), grey.clip(0, 255).astype(np.uint8)[..., None]
    )
    wide, tall = max(1, WIDTH // matrix.shape[1]), max(1, 400 // matrix.shape[0])
    edges = [edge * tall for edge in first[1][:-1]], [edge * wide for edge in first[0][:-1]]
    text = f"white {least:.3g} to black {most:.3g} mV; tinted: no synapse; columns: from"
    image, draw = _framed(drawn.repeat(tall, 0).repeat(wide, 1), text, *edges, room=14 * len(pre))
    for k, name in enumerate(post):
        _label(draw, name, TOP + (first[1][k] + first[1][k + 1]) / 2 * tall)
    for k, name in enumerate(pre):  # each below the other, so that no two overlap
        x = LEFT + edges[1][k]
        draw.line((x, image.height - BOTTOM - 14 * len(pre), x, image.height - BOTTOM - 14 * (len(pre) - k)), "#0072B2")
        draw.text((x + 2, image.height - BOTTOM - 14 * (len(pre) - k)), name, "black")
    return np.asarray(image)


def _framed(
    pixels: np.ndarray, text: str, rows: Sequence[float], columns: Sequence[float], room: int = 0
) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    """Pixels with margins, `room` more below, lines at some rows and columns of theirs, and a text at the bottom."""
    height, width = pixels.shape[:2]
    image = Image.new("RGB", (LEFT + max(width, 400) + RIGHT, TOP + height + room + BOTTOM), "white")
    image.paste(Image.fromarray(np.ascontiguousarray(pixels)), (LEFT, TOP))
    draw = ImageDraw.Draw(image)
    for y in rows:
        draw.line((LEFT, TOP + y, LEFT + width, TOP + y), "#88aacc")
    for x in columns:
        draw.line((LEFT + x, TOP, LEFT + x, TOP + height), "#0072B2")
    draw.text((LEFT, TOP + height + room + 12), text, "black")
    return image, draw


def _label(draw: ImageDraw.ImageDraw, name: str, y: float) -> None:
    """A group's name left of its middle."""
    draw.text((4, y - 6), name.replace("_", " "), "black")


def _starts(network: Network, names: Sequence[str]) -> list[int]:
    return [0, *np.cumsum([network.groups[name].size for name in names]).tolist()]
