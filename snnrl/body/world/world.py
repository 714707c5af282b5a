"""A torus with food, containers and one robot a trial; every tick is a few whole-batch operations."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from snnrl.body.world.geometry import drive, in_disc, offset, orbit
from snnrl.body.world.sensors import RangeSensor, sense
from snnrl.model.draws import Draws, stream
from snnrl.model.elementary import cos, sin

TOUCHES = ("food", "food_container", "empty_container")
OUTSIDE = -1


class World(nn.Module):
    """World and robot of every trial (thesis 3.1 and 3.2). Lengths in cm, float64 throughout.

    There are two kinds of objects. Items (food, or poison from `poison_from` on) lie free, or one in each
    food container; an item is sensed and touched only from where it lies, free ones from outside all
    containers. Containers are sensed only from outside.

    Args:
        draws: owner of all positions.
        side: of the torus.
        free_items, food_containers, empty_containers: how many.
        item_radius, container_radius: of the discs; an item is touched at a smaller distance than its
            radius from its centre.
        axle: distance of the robot's wheels.
        container_speed: factor on the robot's speed inside containers.
        ranges: range sensors, named "food" and "container".
        tick: ms.
        poison_from: time (ms) from which touching an item lowers dopamine; None is never.

    Buffers:
        position [B, 2], heading [B]: the robot. items [B, M, 2], containers [B, C, 2]: centres.
        inside: int64 [B], the container the robot is in, or -1.
        touches: int64 [B, 3], how often each of TOUCHES has happened.
    """

    position: Tensor
    heading: Tensor
    items: Tensor
    containers: Tensor
    inside: Tensor
    touches: Tensor
    home: Tensor

    def __init__(
        self,
        draws: Draws,
        side: float,
        free_items: int,
        food_containers: int,
        empty_containers: int,
        item_radius: float,
        container_radius: float,
        axle: float,
        container_speed: float,
        ranges: Mapping[str, RangeSensor],
        tick: int,
        poison_from: int | None = None,
    ) -> None:
        super().__init__()
        self.draws, self.side, self.axle, self.tick = draws, side, axle, tick
        self.free_items, self.food_containers = free_items, food_containers
        self.empty_containers = empty_containers
        self.item_radius, self.container_radius = item_radius, container_radius
        self.container_speed, self.ranges, self.poison_from = container_speed, dict(ranges), poison_from
        device = draws.trials.device
        # home: the container an item lies in
        home = torch.cat([torch.full((free_items,), OUTSIDE), torch.arange(food_containers)])
        self.register_buffer("home", home.to(device), persistent=False)
        robot = draws.at_start(stream("robot"), 3)
        items, containers = self._places("start", torch.zeros(1, dtype=torch.int64, device=device))
        self.register_buffer("position", side * robot[:, :2])
        self.register_buffer("heading", 2.0 * torch.pi * robot[:, 2])
        self.register_buffer("items", items)
        empty = side * draws.at_start(stream("start", "empty_container"), 4 * empty_containers)
        empty = empty.view(len(robot), empty_containers, 4)[..., :2]
        self.register_buffer("containers", torch.cat([containers, empty], 1))
        self.register_buffer("inside", torch.full_like(draws.trials, OUTSIDE))
        self.register_buffer("touches", self.inside.new_zeros(len(robot), len(TOUCHES)))

    def start_orbiting(self, slow: float, fast: float) -> None:
        """Put the robot on its orbit round the first item, anticlockwise (thesis 4.1).

        A run begins with a tick straight ahead, so the robot starts one such tick before a corner of its
        orbit, with the heading that it has after that corner. Its angle round the item is random.
        """
        seconds = self.tick / 1000.0
        radius, turn = orbit(slow, fast, seconds, self.axle)
        angle = self.heading.clone()
        heading = angle + 0.5 * (torch.pi + turn)
        corner = self.items[:, 0] + radius * torch.stack([cos(angle), sin(angle)], 1)
        ahead = 0.5 * (slow + fast) * seconds * torch.stack([cos(heading), sin(heading)], 1)
        self.position.copy_(torch.remainder(corner - ahead, self.side))
        self.heading.copy_(torch.remainder(heading, 2.0 * torch.pi))

    def _apply(self, fn, recurse: bool = True) -> World:  # type: ignore[no-untyped-def]
        precise = {key: buffer for key, buffer in self._buffers.items() if buffer is not None}
        super()._apply(fn, recurse)
        for key, buffer in precise.items():  # positions stay float64 whatever the network's precision
            self._buffers[key] = buffer.to(self.touches.device)
        self.draws = self.draws.to(self.touches.device)
        return self

    def _places(self, when: str, time: Tensor) -> tuple[Tensor, Tensor]:
        """Fresh places at `time` [1] for every item [B, M, 2] and every food container [B, C, 2].

        `when` names the streams: those of the start and those of what has moved are not the same.
        """
        free, holding = (
            self.draws.uniform(stream(when, kind), time, 4 * count)[0].view(len(self.draws.trials), count, 4)
            for kind, count in (("food", self.free_items), ("food_container", self.food_containers))
        )
        containers = self.side * holding[..., :2]
        held = torch.remainder(containers + in_disc(self.container_radius, holding[..., 2:]), self.side)
        return torch.cat([self.side * free[..., :2], held], 1), containers

    def step(self, wheels: Tensor, time: Tensor) -> dict[str, Tensor]:
        """Move the robot through one tick; what it touched, bool [B] by the names of TOUCHES.

        1. The robot moves, more slowly if it was inside a container.
        2. It is inside the container it was in, if it still is, else the nearest that it is in;
           entering one is felt once.
        3. Items within touch are taken. Free ones reappear elsewhere; a container moves with its item,
           and the robot is outside again.

        Args:
            wheels: speed of the left and right wheel, [B, 2], cm/s.
            time: int64 scalar, ms.
        """
        speed = torch.where(self.inside >= 0, self.container_speed, 1.0).double()
        position, heading = drive(
            self.position, self.heading, wheels * speed[:, None], self.tick / 1000.0, self.axle, self.side
        )
        self.position.copy_(position)
        self.heading.copy_(heading)
        entered = self._enter()
        way = offset(position[:, None], self.items, self.side)
        reached = way[..., 0] * way[..., 0] + way[..., 1] * way[..., 1] < self.item_radius**2
        taken = reached & (self.home == self.inside[:, None])
        self._replace(taken, time)
        holds_food = entered & (self.inside < self.food_containers)
        touched = torch.stack([taken.any(1), holds_food, entered & ~holds_food], 1)
        self.touches += torch.stack([taken.sum(1), touched[:, 1], touched[:, 2]], 1)
        emptied = (taken & (self.home >= 0)).any(1)
        self.inside.copy_(torch.where(emptied, OUTSIDE, self.inside))
        return dict(zip(TOUCHES, touched.unbind(1), strict=True))

    def _enter(self) -> Tensor:
        """Bring `inside` up to date; who entered a container just now, bool [B]."""
        if self.containers.shape[1] == 0:
            return torch.zeros_like(self.inside, dtype=torch.bool)
        way = offset(self.position[:, None], self.containers, self.side)
        distance = way[..., 0] * way[..., 0] + way[..., 1] * way[..., 1]
        within = distance < self.container_radius**2
        stays = (self.inside >= 0) & within.gather(1, self.inside.clamp_min(0)[:, None])[:, 0]
        nearest = torch.where(within.any(1), distance.argmin(1), OUTSIDE)
        entered = ~stays & (nearest >= 0)
        self.inside.copy_(torch.where(stays, self.inside, nearest))
        return entered

    def _replace(self, taken: Tensor, time: Tensor) -> None:
        items, containers = self._places("moved", time.view(1))
        self.items.copy_(torch.where(taken[..., None], items, self.items))
        moved = taken[:, self.free_items :, None]
        held = self.containers[:, : self.food_containers]
        held.copy_(torch.where(moved, containers, held))

    def sense(self) -> dict[str, Tensor]:
        """Values of the range sensors from where the robot is now, float64 [B, 2] (left, right)."""
        values = {}
        for name, sensor in self.ranges.items():
            if name == "food":
                objects, radius = self.items, self.item_radius
                visible = self.home == self.inside[:, None]
            else:
                objects, radius = self.containers, self.container_radius
                visible = (self.inside < 0)[:, None].expand(objects.shape[:2])
            way = offset(self.position[:, None], objects, self.side)
            values[name] = sense(sensor, way, self.heading, visible, radius)
        return values

    def nearest_item(self) -> Tensor:
        """Distance from the robot to the centre of the nearest item, sensed or not: float64 [B], cm; inf without."""
        if self.items.shape[1] == 0:
            return torch.full_like(self.heading, torch.inf)
        return offset(self.position[:, None], self.items, self.side).norm(dim=2).amin(1)

    def sign(self, time: Tensor) -> Tensor:
        """+1, or -1 where items are poison at int64 scalar `time`: float64 [B]."""
        ones = torch.ones_like(self.heading)
        return ones if self.poison_from is None else torch.where(time >= self.poison_from, -ones, ones)
