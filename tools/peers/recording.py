"""The food-only brain with the currents of its own closed loop: an input for any simulator, and what it gives back."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import make_engine
from snnrl.model.network import Network
from snnrl.simulation import Simulation


def robots(trials: int, *options: str) -> Simulation[Any]:
    """In float64, at the start."""
    return build(compose("+experiment=food_attraction", f"trials={trials}", "dtype=float64", "threads=1", *options))


def food_only(trials: int, steps: int, *options: str) -> tuple[Network, Tensor]:
    """The robots' networks at the start, float64, and their currents [steps, trials, N]."""
    simulation = robots(trials, *options)
    network, engine = simulation.network, make_engine("fused", "cpu", 1)
    start, currents = copy.deepcopy(network), []
    while int(network.time) < steps:
        current, sign, _ = simulation.situation.begin(network)
        engine.run_network(network, current, sign)
        currents.append(current)
    return start, torch.cat(currents)[:steps]


@dataclass
class Run:
    """Seconds of wall time of a simulation alone, its spikes [n, 2] (ms, neuron of all trials), plastic weights [S]."""

    wall: float
    spikes: np.ndarray
    weight: np.ndarray
