"""A world as a part of a figure."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from snnrl.body.world import World
from snnrl.body.world.kinds import ENTERED
from snnrl.drawing.palette import CONTAINER, FOOD, OTHER, POISON
from snnrl.schema import FOOD as SCORED


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
