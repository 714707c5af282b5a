"""The world as frames of a film or an environment, many a second.

They are drawn pixel by pixel: a figure of Matplotlib takes many times as long; see `snnrl.drawing.pictures` for those.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw

from snnrl.body.world import World
from snnrl.body.world.kinds import ENTERED
from snnrl.drawing.palette import CONTAINER, EDGE, FOOD, INK, OTHER, POISON
from snnrl.schema import FOOD as SCORED

TRAIL, FRAME = "#9988cc", "#999999"  # of the robot; of the picture
SIDE = 480  # pixels


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
        for u, v in copies(x * scale, pixels - y * scale, r, pixels):
            draw.ellipse((u - r, v - r, u + r, v + r), *style)
    (x, y), heading = world.position[trial].tolist(), float(world.heading[trial])
    corners = [(r * finer, heading + angle) for r, angle in ((12.0, 0.0), (9.0, 2.5), (9.0, -2.5))]
    draw.polygon([(x * scale + r * np.cos(a), pixels - y * scale - r * np.sin(a)) for r, a in corners], INK)
    draw.rectangle((0, 0, pixels - 1, pixels - 1), None, FRAME, finer)
    return np.asarray(image.reduce(finer))


def copies(x: float, y: float, r: float, side: float) -> list[tuple[float, float]]:
    """Where a disc shows on a torus: once, or at both edges that it crosses."""
    across = [[at + shift for shift in (0.0, side, -side) if -r < at + shift < side + r] for at in (x, y)]
    return [(u, v) for u in across[0] for v in across[1]]
