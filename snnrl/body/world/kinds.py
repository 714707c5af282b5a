"""Kinds of objects as tables of numbers: what is where in a world, what holds it, and what touching it does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from snnrl.model.draws import stream
from snnrl.schema import KindConfig, WorldConfig

OUTSIDE = -1  # in place of an object that one is in
TAKEN, ENTERED = range(2)  # what touching does
EFFECTS = {"taken": TAKEN, "entered": ENTERED}
NEVER = 1 << 62  # ms


@dataclass(frozen=True)
class Kinds:
    """K kinds of objects, and the M objects of a world.

    Attributes:
        names: of the kinds.
        radius: float64 [K], cm. speed: float64 [K], factor on the robot's speed inside.
        effect: int64 [K], TAKEN or ENTERED. hides: bool [K], whether from inside only what it holds is sensed.
        sign: float64 [K], of what touching releases. turns: int64 [K], the ms
            from which that sign is the opposite.
        opens: bool [K, K], whether touching the first opens the second. locked: bool [K], whether it needs that.
        started, moved: [K], streams of the places at the start, and of those after a move.
        kind: int64 [M]. number: int64 [M], of an object within its kind, or of its holder.
        holder: int64 [M], the object that holds it; OUTSIDE if none does.
        home: int64 [M], the object that hides it: it is sensed and touched only from there; OUTSIDE if nothing does.
        free: how many of the objects, the first ones, are held by nothing.
    """

    names: tuple[str, ...]
    radius: Tensor
    speed: Tensor
    effect: Tensor
    hides: Tensor
    sign: Tensor
    turns: Tensor
    opens: Tensor
    locked: Tensor
    started: tuple[int, ...]
    moved: tuple[int, ...]
    kind: Tensor
    number: Tensor
    holder: Tensor
    home: Tensor
    free: int

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
            torch.tensor([EFFECTS[kind.touched] for kind in kinds]),
            torch.tensor([kind.hides for kind in kinds]),
            torch.tensor([float(kind.sign) for kind in kinds], dtype=torch.float64),
            torch.tensor([_turn(kind) for kind in kinds]),
            opens,
            opens.any(0),
            tuple(stream("start", name) for name in names),
            tuple(stream("moved", name) for name in names),
            kind=rows[:, 0],
            number=rows[:, 1],
            holder=rows[:, 2],
            home=rows[:, 3],
            free=len(free),
        )

    def to(self, device: torch.device) -> Kinds:
        tensors = {key: value for key, value in vars(self).items() if isinstance(value, Tensor)}
        moved: dict[str, Any] = {key: tensor.to(device) for key, tensor in tensors.items()}
        return replace(self, **moved)

    def index(self, kind: str) -> Tensor:
        """The objects of a kind, int64 [n]; none of one that the world does not have."""
        return (self.kind == (self.names.index(kind) if kind in self.names else OUTSIDE)).nonzero()[:, 0]


def _turn(kind: KindConfig) -> int:
    return NEVER if kind.poison_from is None else round(1000 * kind.poison_from)
