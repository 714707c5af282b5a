"""A torus with objects and one robot a trial; every tick is a few whole-batch operations."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from snnrl.body.world.geometry import drive, in_disc, offset, orbit, room_ahead, straight, within
from snnrl.body.world.kinds import ENTERED, OUTSIDE, STOPS, TAKEN, Kinds, sign_at
from snnrl.body.world.sensors import distance_to, faces, range_value
from snnrl.model.draws import Draws, stream
from snnrl.model.elementary import cos, sin
from snnrl.schema import SensorConfig, WorldConfig


class World(nn.Module):
    """World and robot of every trial (thesis 3.1 and 3.2). Lengths in cm, float64 throughout.

    Objects are discs of some kind. What is taken when touched reappears elsewhere, with its holder if it has one; what
    is entered has the robot inside until it leaves, more slowly, or until what it holds is taken. What a holder hides
    is sensed and touched from inside of it only, and nothing else is then. What stops the robot is not entered: it is
    held at the edge, and touches it in every tick in which it is.

    Args:
        draws: owner of all positions.
        config: side, kinds, sensors.
        tick: ms.

    Buffers:
        position [B, 2], heading [B]: the robot. places [B, M, 2]: centres of the objects (see `Kinds`).
        inside: int64 [B], the object that the robot is in, or OUTSIDE.
        touches: int64 [B, K], how often each kind was touched.
        unlocked: bool [B, K], which kinds that need opening are open.
        sign: [B], of what is released: that of what was touched last.
        absent: bool [B, K], which kinds are not there in this tick; not part of the state, as the time says it.
    """

    position: Tensor
    heading: Tensor
    places: Tensor
    inside: Tensor
    touches: Tensor
    unlocked: Tensor
    sign: Tensor
    absent: Tensor

    def __init__(self, draws: Draws, config: WorldConfig, tick: int) -> None:
        super().__init__()
        self.draws, self.config, self.tick = draws, config, tick
        device = draws.trials.device
        self.kinds = Kinds.of(config).to(device)
        self.attempts = config.attempts if any(kind.avoids for kind in config.kinds.values()) else 1
        self.stops = any(kind.touched == "stops" and kind.count for kind in config.kinds.values())
        self.sees = {name: tuple(sensor.sees or [name]) for name, sensor in config.ranges.items()}
        robot = draws.at_start(stream("robot"), 3)
        trials, count = len(robot), len(self.kinds.names)
        self.register_buffer("position", config.side * robot[:, :2])
        self.register_buffer("heading", 2.0 * torch.pi * robot[:, 2])
        places = self._places(self.kinds.started, torch.zeros(1, dtype=torch.int64, device=device))
        self.register_buffer("places", places)
        self.register_buffer("inside", torch.full_like(draws.trials, OUTSIDE))
        self.register_buffer("touches", self.inside.new_zeros(trials, count))
        self.register_buffer("unlocked", torch.zeros(trials, count, dtype=torch.bool, device=device))
        self.register_buffer("sign", torch.ones_like(self.heading))
        self.register_buffer("absent", torch.zeros_like(self.unlocked), persistent=False)

    def start_orbiting(self, slow: float, fast: float) -> None:
        """Put the robot on its orbit round the first object, anticlockwise (thesis 4.1).

        A run begins with a tick straight ahead, so the robot starts one such tick before a corner of its
        orbit, with the heading that it has after that corner. Its angle round the object is random.
        """
        seconds = self.tick / 1000.0
        radius, turn = orbit(slow, fast, seconds, self.config.axle)
        angle = self.heading.clone()
        heading = angle + 0.5 * (torch.pi + turn)
        corner = self.places[:, 0] + radius * torch.stack([cos(angle), sin(angle)], 1)
        ahead = 0.5 * (slow + fast) * seconds * torch.stack([cos(heading), sin(heading)], 1)
        self.position.copy_(torch.remainder(corner - ahead, self.config.side))
        self.heading.copy_(torch.remainder(heading, 2.0 * torch.pi))

    def _apply(self, fn, recurse: bool = True) -> World:  # type: ignore[no-untyped-def]
        precise = {key: buffer for key, buffer in self._buffers.items() if buffer is not None}
        super()._apply(fn, recurse)
        for key, buffer in precise.items():  # positions stay float64 whatever the network's precision
            self._buffers[key] = buffer.to(self.touches.device)
        self.draws, self.kinds = self.draws.to(self.touches.device), self.kinds.to(self.touches.device)
        return self

    def count(self, kind: str) -> Tensor:
        """How often a kind was touched, int64 [B]; 0 of one that the world does not have."""
        if kind not in self.kinds.names:
            return torch.zeros_like(self.inside)
        return self.touches[:, self.kinds.names.index(kind)]

    def _places(self, streams: tuple[int, ...], time: Tensor, moving: Tensor | None = None) -> Tensor:
        """Fresh places for all objects at `time` [1], [B, M, 2]; those that are held lie in their holder's disc.

        `moving`, bool [B, M], says which will move there; None is all, at the start.
        """
        kinds, trials = self.kinds, len(self.draws.trials)
        drawn = []
        for k, name in enumerate(kinds.names):
            count = self.config.kinds[name].count
            drawn.append(
                self.draws.uniform(streams[k], time, 4 * count * self.attempts)[0].view(trials, self.attempts, count, 4)
            )
        tried = torch.cat(drawn, 2)  # [B, attempts, M free, 4]
        uniform = tried[:, 0] if self.attempts == 1 else self._clear(tried, moving)
        places = self.config.side * uniform[..., :2]
        holder = kinds.holder[kinds.free :]
        way = in_disc(kinds.room[kinds.kind[holder]], uniform[:, holder, 2], uniform[:, holder, 3])
        held = torch.remainder(places[:, holder] + torch.stack(way, -1), self.config.side)
        return torch.cat([places, held], 1)

    def _clear(self, tried: Tensor, moving: Tensor | None) -> Tensor:
        """Of what was tried for each object, the first that is clear of what its kind avoids, or the last.

        One object after the other, in `Kinds.order`: one that has moved is in the way of the next, one that has not
        been placed yet, at the start, is not. What stops the robot has its place first.

        Args:
            tried: uniform in [0, 1), [B, attempts, M free, 4], of which the first two are a place. [B, M free, 4] back.
            moving: as for `_places`.
        """
        kinds, side = self.kinds, self.config.side
        kind = kinds.kind[: kinds.free]
        effect = kinds.effect[kind]
        radius, solid = kinds.radius[kind], effect != TAKEN
        others = ~torch.eye(kinds.free, dtype=torch.bool, device=kind.device)
        off_robot, apart = kinds.off_robot[kind], kinds.apart[kind][:, effect] & others
        standing = torch.zeros_like(solid) if moving is None else solid.clone()
        places = side * tried[:, 0, :, :2] if moving is None else self.places[:, : kinds.free].clone()
        uniform = tried[:, 0].clone()
        for m in kinds.order:
            place = side * tried[:, :, m, :2]
            way = offset(place[:, :, None], places[:, None], side)
            to_robot = offset(place, self.position[:, None], side)
            overlaps = within(way[..., 0], way[..., 1], radius[m] + radius) & standing & apart[m]
            on_robot = within(to_robot[..., 0], to_robot[..., 1], radius[m])
            blocked = overlaps.any(2) | on_robot & off_robot[m]
            which = torch.where(blocked.all(1), self.attempts - 1, (~blocked).long().argmax(1))
            uniform[:, m] = tried[:, :, m].gather(1, which[:, None, None].expand(-1, 1, 4))[:, 0]
            moved = side * uniform[:, m, :2]
            places[:, m] = moved if moving is None else torch.where(moving[:, m, None], moved, places[:, m])
            standing[m] = solid[m]
        return uniform

    def step(self, wheels: Tensor, time: Tensor) -> dict[str, Tensor]:
        """Move the robot through one tick; which kinds it touched, bool [B] by name.

        1. The robot moves, more slowly if it was inside an object, and no farther than to the edge of the first that
           stops it, which it touches.
        2. It is inside the object it was in, if it still is, else the nearest that it is in and that is open; or
           (`overlap: nearest`) the nearest of these in any case. Entering one is touching it.
        3. Objects within touch are taken, unless they are absent, and reappear elsewhere; a holder moves with what it
           holds, is locked again, and the robot is outside.
        4. What was touched opens what it opens, and gives what is released its sign.

        Args:
            wheels: speed of the left and right wheel, [B, 2], cm/s.
            time: int64 scalar, ms.
        """
        kinds, side = self.kinds, self.config.side
        slowed = torch.where(self.inside >= 0, kinds.speed[self._kind_inside()], 1.0)
        left, right = (wheels * slowed[:, None]).unbind(1)
        x, y = self.position.unbind(1)
        seconds = self.tick / 1000.0
        room, stopped = self._room(straight(left, right, seconds))
        x, y, heading = drive(x, y, self.heading, left, right, seconds, self.config.axle, side, room)
        self.position.copy_(torch.stack([x, y], 1))
        self.heading.copy_(heading)
        dx, dy = self._way()
        touching = within(dx, dy, kinds.radius[kinds.kind])
        entered = self._enter(dx * dx + dy * dy, touching)
        self.absent.copy_(((time >= kinds.leaves) & (time < kinds.returns)).expand_as(self.absent))
        present = ~self.absent[:, kinds.kind]
        taken = touching & present & (kinds.effect[kinds.kind] == TAKEN) & (kinds.home == self._place()[:, None])
        self._move(taken, time)
        touched = torch.zeros_like(self.touches).index_add_(1, kinds.kind, (taken | entered | stopped).long())
        self.touches += touched
        self._open(touched > 0)
        self._set_sign(touched > 0, time)
        return dict(zip(kinds.names, (touched > 0).unbind(1), strict=True))

    def _way(self) -> tuple[Tensor, Tensor]:
        """From the robot to the centre of every object, [B, M] along each axis."""
        way = offset(self.position[:, None], self.places, self.config.side)
        return way[..., 0], way[..., 1]

    def _room(self, way: Tensor) -> tuple[Tensor, Tensor]:
        """How far the robot can go ahead (cm), [B], and what stops it before it has gone its way, bool [B, M]."""
        kinds = self.kinds
        if not self.stops:
            return torch.full_like(way, torch.inf), torch.zeros_like(kinds.kind, dtype=torch.bool).expand(len(way), -1)
        dx, dy = self._way()
        along, across = cos(self.heading)[:, None], sin(self.heading)[:, None]
        room = room_ahead(dx, dy, along, across, kinds.radius[kinds.kind])
        room = torch.where(kinds.effect[kinds.kind] == STOPS, room, torch.inf)
        nearest, which = room.min(1)
        objects = torch.arange(len(kinds.kind), device=way.device)
        return nearest, (nearest < way)[:, None] & (objects == which[:, None])

    def _kind_inside(self) -> Tensor:
        """The kind of the object that the robot is in, int64 [B]; any where it is in none."""
        return self.kinds.kind[self.inside.clamp_min(0)] if len(self.kinds.kind) else torch.zeros_like(self.inside)

    def _place(self) -> Tensor:
        """From where the robot senses and touches: the object it is in, if that hides, else OUTSIDE; int64 [B]."""
        return torch.where(self.kinds.hides[self._kind_inside()], self.inside, OUTSIDE)

    def _enter(self, squared: Tensor, touching: Tensor) -> Tensor:
        """Bring `inside` up to date; which object was entered just now, bool [B, M]."""
        kinds = self.kinds
        if not len(kinds.kind):
            return touching
        objects = torch.arange(len(kinds.kind), device=touching.device)
        before = objects == self.inside[:, None]
        is_open = (self.unlocked | ~kinds.locked)[:, kinds.kind]
        allowed = touching & (is_open | before) & (kinds.effect[kinds.kind] == ENTERED)
        if self.config.overlap == "stays":
            allowed = torch.where((allowed & before).any(1, keepdim=True), before, allowed)
        nearest = torch.where(allowed, squared, torch.inf).argmin(1)
        self.inside.copy_(torch.where(allowed.any(1), nearest, OUTSIDE))
        return allowed & ~before & (objects == nearest[:, None])

    def _move(self, taken: Tensor, time: Tensor) -> None:
        """Put what was taken elsewhere, with its holder, which is locked again; the robot is then outside of it."""
        kinds = self.kinds
        emptied = torch.zeros_like(taken, dtype=torch.int64)
        emptied.index_add_(1, kinds.holder[kinds.free :], taken[:, kinds.free :].long())
        moving = taken | (emptied > 0)
        places = self._places(kinds.moved, time.view(1), moving)
        self.places.copy_(torch.where(moving[..., None], places, self.places))
        locked = torch.zeros_like(self.touches).index_add_(1, kinds.kind, emptied)
        self.unlocked &= locked == 0
        if len(kinds.kind):
            left = (self.inside >= 0) & (emptied.gather(1, self.inside.clamp_min(0)[:, None])[:, 0] > 0)
            self.inside.copy_(torch.where(left, OUTSIDE, self.inside))

    def _open(self, touched: Tensor) -> None:
        self.unlocked |= (touched[:, :, None] & self.kinds.opens).any(1)

    def _set_sign(self, touched: Tensor, time: Tensor) -> None:
        """That of what was touched in this tick, negative before positive; else as it was."""
        value = torch.where(touched, self.value(time), torch.inf).amin(1)
        self.sign.copy_(torch.where(touched.any(1), value, self.sign))

    def value(self, time: Tensor) -> Tensor:
        """The sign of what touching each kind releases at int64 scalar `time` (ms), float64 [K]."""
        return sign_at(time, self.kinds.sign, self.kinds.turns, self.kinds.again)

    def sense(self) -> dict[str, Tensor]:
        """Values of the range sensors from where the robot is now, float64 [B, 2] (left, right)."""
        return {name: self._sense(sensor, self.sees[name]) for name, sensor in self.config.ranges.items()}

    def _sense(self, sensor: SensorConfig, sees: tuple[str, ...]) -> Tensor:
        kinds = self.kinds
        if not len(kinds.kind):
            return torch.zeros_like(self.position)
        dx, dy = self._way()
        ahead, leftward = faces(dx, dy, cos(self.heading)[:, None], sin(self.heading)[:, None])
        seen = torch.tensor([name in sees for name in kinds.names], device=dx.device)[kinds.kind]
        visible = ahead & seen & ~self.absent[:, kinds.kind] & (kinds.home == self._place()[:, None])
        inner = kinds.radius[kinds.kind] * float(sensor.measured_to == "border")
        distance = torch.where(visible, distance_to(dx, dy, inner), torch.inf)
        sides = torch.stack([leftward, ~leftward], 2)
        value = range_value(torch.where(sides, distance[..., None], torch.inf).amin(1), sensor.reach)
        if sensor.answers == "both":
            return value
        nearest = distance.min(1).indices
        return value * sides.take_along_dim(nearest[:, None, None], 1)[:, 0]

    def nearest_item(self) -> Tensor:
        """Distance from the robot to the centre of the nearest thing to take, sensed or not (cm), [B]; inf of none."""
        items = self.kinds.effect[self.kinds.kind] == TAKEN
        way = offset(self.position[:, None], self.places[:, items], self.config.side)
        return torch.cat([way.norm(dim=2), torch.full_like(self.heading[:, None], torch.inf)], 1).amin(1)
