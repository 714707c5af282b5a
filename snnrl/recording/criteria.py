"""When a trial counts as having learnt a behaviour."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import torch
from torch import Tensor

from snnrl.model.network import Network

STRENGTH = 0.5  # mV that attraction must exceed (thesis 4.2 and 4.5)
LEAD = 1.1  # factor by which attraction must exceed avoidance


def learnt(attraction: Tensor, avoidance: Tensor) -> Tensor:
    """Whether attraction is strong and leads; bool of the shape of the mean weights (mV)."""
    return (attraction > STRENGTH) & (attraction > LEAD * avoidance)


def taxis_learnt(network: Network, taxis: str, rule: str) -> Tensor:
    """Whether each trial has learnt the attraction of a taxis, bool [B].

    Args:
        taxis: its projections have the roles TAXIS_attraction and TAXIS_avoidance.
        rule: `together` compares the means over both sides (thesis 4.2), `each_side` asks it of the
            left and of the right sensor (thesis 4.5).
    """
    means: dict[str, dict[str, Tensor]] = defaultdict(dict)
    for projection in network.projections.values():
        if projection.role in (f"{taxis}_attraction", f"{taxis}_avoidance"):
            means[projection.role][projection.pre] = projection.mean_weight()
    attraction, avoidance = (
        torch.stack([means[f"{taxis}_{kind}"][pre] for pre in sorted(means[f"{taxis}_{kind}"])])
        for kind in ("attraction", "avoidance")
    )
    if rule == "together":
        return learnt(attraction.mean(0), avoidance.mean(0))
    return learnt(attraction, avoidance).all(0)


def correct(network: Network, rules: Mapping[str, str]) -> Tensor:
    """Whether each trial has learnt all the taxes that an experiment asks for, bool [B]."""
    result = torch.ones(network.trials, dtype=torch.bool, device=network.device)
    for taxis, rule in rules.items():
        result &= taxis_learnt(network, taxis, rule)
    return result
