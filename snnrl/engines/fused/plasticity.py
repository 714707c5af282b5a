"""What steps 4, 5 and 7 of `Network.step` are made of: synapses, only where a spike passes.

Most synapses see no spike in most milliseconds, so eligibility and weight are brought up to date only when they are
needed. Within a block of milliseconds, with lambda = exp(-1 / tau_eligibility):

- A synapse keeps `scaled` = eligibility / lambda^k at the k-th ms of the block, which only spikes change.
- For each signal, the sum of modulators that a synapse listens to, the trial keeps `drive`, the sum of lambda^k times
  the signal since all weights were settled. A weight that was settled when that was `settled` is now, by an additive
  weight rule (`snnrl.model.plasticity.additive`), that of a single change of scaled * (drive - settled).
- So it is as long as neither eligibility changes (then the synapse is settled first) nor the signal its sign (then all
  synapses are).

Synapses whose rule is not additive are all updated in every ms. How they are kept, `tiles` or `lists`, changes them by
rounding at most: sets are added up in another order, and so all weights are settled at other times.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from snnrl.engines.fused.compiler import placeholder, spelled
from snnrl.engines.fused.vectors import LANES, across, counting, gather, load, select, store
from snnrl.engines.layout import BOUNDS, PLACE, SIZE, WEIGHT_RULE, Functions


@placeholder
def bound(which, weight, change, values, at):
    """A weight after a change, by one of the weight rules, with further arguments from `at` on."""


def settled_weight(t, rule, weight, scaled, change):
    """A weight that `scaled` times a drive has acted on."""
    return bound(t.rules[rule, WEIGHT_RULE], weight, scaled * change, t.bounds, t.rules[rule, BOUNDS])


def look_up(t, out, at, group, last, now, first, end, together):
    """What a spike adds for each neuron of a group, by the ms since its last spike, into `out` from `at` on.

    What is behind the group there, up to a whole vector, is 0 then.

    `together` is what it adds where that is none.
    """
    place, size, longest = t.groups[group, PLACE], t.groups[group, SIZE], end - 1 - first
    for i in range(0, size, LANES):
        elapsed = now - load(last, place + i)
        within = select(elapsed < longest, elapsed, longest)
        added = gather(t.windows, select(within > 0, within, 0) + first)
        added = select(elapsed > 0, added, together)
        store(out, at + i, select(counting(i, LANES) < size, added, added * 0.0))


def risen(values, at, size, positive):
    """The sum of those of `size` values that raise a weight while its signal has that sign."""
    total = load(values, at) * 0.0
    for i in range(0, size, LANES):
        value = load(values, at + i)
        upward = value if positive else -value
        total = total + select((counting(i, LANES) < size) & (upward > 0.0), upward, upward * 0.0)
    return across(total)


def feed(t, w, slot, place, size):
    """Note that something is pending for some neurons."""
    blocks = t.places // LANES
    for b in range(place // LANES, (place + size - 1) // LANES + 1):
        w.fed[slot * blocks + b] = True


def bounding(functions: Functions) -> dict[str, Callable[..., Any]]:
    """What `bound` and the names in it stand for in a network of those weight rules."""
    lines, names = [], {}
    for k, (function, count) in enumerate(functions.weight_rules):
        names[f"rule_{k}"] = function
        given = "".join(f", values[at + {i}]" for i in range(count))
        lines += [f"    if which == {k}:", f"        return rule_{k}(weight, change{given})"]
    if lines:
        lines[-2] = "    if True:"  # the last needs no question
    body = "\n".join(lines or ["    return weight"])
    return {"bound": spelled("bound", "which, weight, change, values, at", body, {}), **names}
