"""What a pair of spikes leaves in a synapse, and what dopamine makes of it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from snnrl.model.elementary import exp, exp_of

Rule = Callable[..., Tensor]
LONGEST = 1 << 20  # ms that a pair may be apart
FORGOTTEN = 2.0**-54  # of the largest value of a window: what adds less, adds nothing


def potentiate(elapsed: Tensor, potentiation: float, tau_plus: float) -> Tensor:
    """What a postsynaptic spike adds to the eligibility, `elapsed` ms after the presynaptic one (thesis 3.7)."""
    return potentiation * exp(elapsed / -tau_plus)


def potentiate_later(elapsed: Tensor, potentiation: float, tau_plus: float) -> Tensor:
    """As `potentiate`, but most at `tau_plus` ms and nothing at once: a spike's own answer does not strengthen it."""
    return potentiation * (elapsed / tau_plus) * exp(1.0 - elapsed / tau_plus)


def depress(elapsed: Tensor, depression: float, tau_minus: float) -> Tensor:
    """What a presynaptic spike adds to the eligibility, `elapsed` ms after the postsynaptic one (thesis 3.7)."""
    return -depression * exp(elapsed / -tau_minus)


def additive(rule: Rule) -> Rule:
    """Declare of a weight rule that changes of one sign add up: rule(rule(w, x), y) is rule(w, x + y).

    Then a synapse need not be touched in every ms, only when its eligibility changes or its weight is asked for.
    """
    rule.additive = True  # type: ignore[attr-defined]
    return rule


@additive
def hard_bounds(weight: Tensor, change: Tensor, weight_min: float, weight_max: float) -> Tensor:
    """The change, as far as the bounds (mV) allow."""
    return torch.clamp(weight + change, weight_min, weight_max)


@dataclass(frozen=True)
class Plasticity:
    """STDP into an eligibility that dopamine turns into weight (thesis 3.7; Izhikevich 2007).

    Only nearest neighbours pair: a spike with the latest one of the other neuron. Two spikes of one ms are a pair
    at no distance, which `simultaneous` says what to make of. Where it potentiates (the thesis), it is the only pair
    of that ms. Where it depresses (Izhikevich 2007: the presynaptic spike is still on its way), the postsynaptic
    spike also pairs with the presynaptic neuron's latest earlier one.

    Potentiation may count from a presynaptic spike's arrival, `travel` ms after it left. Then a spike of one ms is
    still on its way, so two of these depress, and a postsynaptic spike whose presynaptic neuron's latest earlier spike
    is on its way pairs with none. Depression counts from departure: from there on the postsynaptic spike is the
    earlier one.

    Attributes:
        potentiation, depression: A+ and A-, the change of eligibility by one pair at no distance.
        tau_plus, tau_minus: width of the two halves of the window (ms).
        tau_eligibility: decay of the eligibility (ms).
        weight_max: plastic weights stay in [weight_min, weight_max] (mV).
        simultaneous: what a pair of spikes of one ms does, "potentiates" or "depresses".
        travel: ms after a presynaptic spike left at which it can potentiate, most; 0 counts from departure.
        at_post, at_pre: what a pair adds to the eligibility at its postsynaptic or presynaptic spike, elementwise
            functions of the ms since the other spike. weight_rule: an elementwise function of a weight and of what
            eligibility times dopamine would change it by in one ms, to the new weight. The further arguments of the
            three are values of this object, or of `values`, of the same name.
        values: further numbers for those functions.
        gains, losses: what a pair adds by the ms since the other spike left, float64 [K] each, the last 0.
        decay: of the eligibility in one ms.

    Raises:
        ValueError: a function has an argument that nothing here is called like, or a window does not end; a spike
            travels, and those of one ms potentiate.
    """

    potentiation: float
    depression: float
    tau_plus: float
    tau_minus: float
    tau_eligibility: float
    weight_max: float
    simultaneous: str = "potentiates"
    weight_min: float = 0.0
    at_post: Rule = potentiate
    at_pre: Rule = depress
    weight_rule: Rule = hard_bounds
    values: Mapping[str, float] = field(default_factory=dict, hash=False)
    travel: int = 0
    gains: Tensor = field(init=False, compare=False, repr=False)
    losses: Tensor = field(init=False, compare=False, repr=False)
    decay: float = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.travel and self.simultaneous != "depresses":
            raise ValueError("simultaneous: must be depresses where a spike potentiates after its travel")
        self.bounds  # noqa: B018  # so that a name that is missing is noticed here
        object.__setattr__(self, "decay", exp_of(-1.0 / self.tau_eligibility))
        for name, function in (("gains", self.at_post), ("losses", self.at_pre)):
            object.__setattr__(self, name, window(function, self.arguments(function, 1)))
        object.__setattr__(self, "gains", torch.cat([self.gains.new_zeros(self.travel), self.gains]))

    def arguments(self, function: Rule, given: int) -> tuple[float, ...]:
        """The values of a function's arguments after the first `given` ones."""
        return arguments(function, given, {**self.__dict__, **self.values})

    @property
    def bounds(self) -> tuple[float, ...]:
        """The values of the weight rule's further arguments."""
        return self.arguments(self.weight_rule, 2)

    @property
    def adds_up(self) -> bool:
        """Whether the weight rule is `additive`."""
        return bool(getattr(self.weight_rule, "additive", False))

    def step(self, weight: Tensor, change: Tensor) -> Tensor:
        """Weights (mV) after one ms in which eligibility times dopamine is `change`; the same shape."""
        return self.weight_rule(weight, change, *self.bounds)


def arguments(function: Callable[..., Any], given: int, values: Mapping[str, Any]) -> tuple[float, ...]:
    """Values, by name, for a function's arguments after the first `given` ones.

    Raises:
        ValueError: there is none for one of them.
    """
    names = list(inspect.signature(function).parameters)[given:]
    for name in names:
        if not isinstance(values.get(name), (int, float)):
            known = ", ".join(key for key, value in values.items() if isinstance(value, (int, float)))
            raise ValueError(f"{function.__name__}: no value is called {name}; there are {known}")
    return tuple(float(values[name]) for name in names)


def window(function: Rule, values: tuple[float, ...]) -> Tensor:
    """A function of elapsed ms as a table, float64 [K], that ends with 0 where nothing is left of it.

    Raises:
        ValueError: it has not become small after LONGEST ms, or is not finite.
    """
    length = 64
    while length <= LONGEST:
        found = function(torch.arange(length, dtype=torch.float64), *values).double().expand(length)
        if not bool(found.isfinite().all()):
            raise ValueError(f"{function.__name__}: not finite for some interval")
        size = found.abs()
        left = (size > FORGOTTEN * size.max()).nonzero()
        end = int(left[-1]) + 1 if len(left) else 0
        if end < length // 2:
            return torch.cat([found[:end], found.new_zeros(1)])
        length *= 2
    raise ValueError(f"{function.__name__}: does not fade within {LONGEST} ms")
