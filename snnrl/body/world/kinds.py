"""Kinds of objects as tables of numbers: what is where in a world, what holds it, and what touching it does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from snnrl.model.draws import stream
from snnrl.schema import KindConfig, WorldConfig

OUTSIDE = -1  # in place of an object that one is in
STOPS, TAKEN, ENTERED = range(3)  # what touching does, in the order in which objects find their places
EFFECTS = {"stops": STOPS, "taken": TAKEN, "entered": ENTERED}
AVOIDED = {"obstacles": STOPS, "containers": ENTERED}
NEVER = 1 << 62  # ms


@dataclass(frozen=True)
class Kinds:
    """K kinds of objects, and the M objects of a world.

    Attributes:
        names: of the kinds.
        radius: float64 [K], cm. speed: float64 [K], factor on the robot's speed inside.
        room: float64 [K], the radius within which the centre of what it holds lies, cm.
        effect: int64 [K], STOPS, TAKEN or ENTERED. hides: bool [K], whether from inside only what it holds is sensed.
        sign: float64 [K], of what touching releases. turns, again: int64 [K], the ms at which that sign turns to the
            opposite, and those from one turn to the next.
        leaves, returns: int64 [K], the ms from which none is there to be sensed or taken, and from which all are again.
        off_robot: bool [K], whether none lands on the robot.
        apart: bool [K, 3], whether none overlaps what stops the robot, is taken (never), is entered.
        opens: bool [K, K], whether touching the first opens the second. locked: bool [K], whether it needs that.
        started, moved: [K], streams of the places at the start, and of those after a move.
        counts: int64 [K], of those that are held by nothing.
        kind: int64 [M]. number: int64 [M], of an object within its kind, or of its holder.
        holder: int64 [M], the object that holds it; OUTSIDE if none does.
        home: int64 [M], the object that hides it: it is sensed and touched only from there; OUTSIDE if nothing does.
        free: how many of the objects, the first ones, are held by nothing.
        order: of these, that in which they move within a tick: what is taken first.
    """

    names: tuple[str, ...]
    radius: Tensor
    speed: Tensor
    room: Tensor
    effect: Tensor
    hides: Tensor
    sign: Tensor
    turns: Tensor
    again: Tensor
    leaves: Tensor
    returns: Tensor
    off_robot: Tensor
    apart: Tensor
    opens: Tensor
    locked: Tensor
    started: tuple[int, ...]
    moved: tuple[int, ...]
    counts: Tensor
    kind: Tensor
    number: Tensor
    holder: Tensor
    home: Tensor
    free: int
    order: tuple[int, ...]

    @classmethod
    def of(cls, config: WorldConfig) -> Kinds:
        """The kinds of a configuration: first all objects that lie free, kind by kind, then what some of them hold."""
        names, kinds = tuple(config.kinds), list(config.kinds.values())
        free = [(k, number) for k, kind in enumerate(kinds) for number in range(kind.count)]
        held = [
            (names.index(kinds[k].holds), number, holder, holder if kinds[k].hides else OUTSIDE)
            for holder, (k, number) in enumerate(free)
            if kinds[k].holds
        ]
        rows = torch.tensor([(*one, OUTSIDE, OUTSIDE) for one in free] + held, dtype=torch.int64).reshape(-1, 4)
        opens = torch.tensor([[name in kind.opens for name in names] for kind in kinds])
        return cls(
            names,
            torch.tensor([kind.radius for kind in kinds], dtype=torch.float64),
            torch.tensor([kind.speed for kind in kinds], dtype=torch.float64),
            torch.tensor([_room(kind, config) for kind in kinds], dtype=torch.float64),
            torch.tensor([EFFECTS[kind.touched] for kind in kinds]),
            torch.tensor([kind.hides for kind in kinds]),
            torch.tensor([float(kind.sign) for kind in kinds], dtype=torch.float64),
            torch.tensor([_ms(kind.turns_every if kind.poison_from is None else kind.poison_from) for kind in kinds]),
            torch.tensor([_ms(kind.turns_every) for kind in kinds]),
            torch.tensor([_ms(kind.absent_from) for kind in kinds]),
            torch.tensor([_ms(kind.absent_until) for kind in kinds]),
            torch.tensor(["robot" in kind.avoids for kind in kinds]),
            torch.tensor(
                [[any(AVOIDED.get(name) == effect for name in kind.avoids) for effect in range(3)] for kind in kinds]
            ),
            opens,
            opens.any(0),
            tuple(stream("start", name) for name in names),
            tuple(stream("moved", name) for name in names),
            torch.tensor([kind.count for kind in kinds]),
            kind=rows[:, 0],
            number=rows[:, 1],
            holder=rows[:, 2],
            home=rows[:, 3],
            free=len(free),
            order=tuple(sorted(range(len(free)), key=lambda m: EFFECTS[kinds[free[m][0]].touched])),
        )

    def to(self, device: torch.device) -> Kinds:
        tensors = {key: value for key, value in vars(self).items() if isinstance(value, Tensor)}
        moved: dict[str, Any] = {key: tensor.to(device) for key, tensor in tensors.items()}
        return replace(self, **moved)

    def index(self, kind: str) -> Tensor:
        """The objects of a kind, int64 [n]; none of one that the world does not have."""
        return (self.kind == (self.names.index(kind) if kind in self.names else OUTSIDE)).nonzero()[:, 0]


def _room(kind: KindConfig, config: WorldConfig) -> float:
    return kind.radius - (config.kinds[kind.holds].radius if kind.contains == "whole" else 0.0)


def _ms(seconds: float | None) -> int:
    return NEVER if seconds is None else round(1000 * seconds)


def sign_at(time: Tensor, sign: Tensor, turns: Tensor, again: Tensor) -> Tensor:
    """A kind's sign at a time (ms), if it turns at `turns` and then every `again` ms; elementwise."""
    turned = (time >= turns) & ((time - turns) // again % 2 == 0)
    return torch.where(turned, -sign, sign)
