"""The same trial has the same bits on every machine: a digest for each stage on its way, so that the first that differs
says where. (`test_elementary` holds the functions that a trial would otherwise ask a library for.)

After a change that is meant to change results, run `python tests/test_bits.py`, and say which and why in its commit.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import compose_config
from torch import Tensor

from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.engines.fused.vectors import LANES
from snnrl.engines.layout import tables, topology
from snnrl.simulation import Simulation

FILE = Path(__file__).parent / "bits.json"
EXPERIMENTS = ("food_attraction", "dual_learning")
STAGES = {"after 1 tick": 0.07, "after 1 s": 1.0, "after 10 s": 10.0, "after 100 s": 100.0}  # simulated s


def digest(*values: Tensor | np.ndarray) -> str:
    found = hashlib.sha256()
    for value in values:
        array = np.ascontiguousarray(value)
        found.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return found.hexdigest()[:16]


def state(simulation: Simulation) -> str:
    return digest(*(values for _, values in sorted(simulation.state_dict().items())))


def stages(experiment: str) -> dict[str, str]:
    """A digest by stage, in the order in which a trial comes by them."""
    simulation = build(compose_config(f"+experiment={experiment}", "trials=4"))
    network, coding = simulation.network, simulation.situation.coding
    laid_out, _ = tables(network, topology(network, LANES), LANES)
    numbers = [value for value in laid_out if isinstance(value, np.ndarray)]
    found = {
        "thresholds of pulses": digest(coding.touch_thresholds, coding.exploration_thresholds),
        "tables": digest(*numbers),
        "at the start": state(simulation),
    }
    engine, done = make_engine("fused", "cpu", 1), 0
    for name, seconds in STAGES.items():
        ticks = round(1000 * seconds / simulation.tick)
        simulation.run(engine, ticks - done)
        done, found[name] = ticks, state(simulation)
    return found


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_every_stage_has_the_bits_that_are_recorded(experiment: str) -> None:
    recorded = json.loads(FILE.read_text())[experiment]
    found = stages(experiment)
    assert list(found) == list(recorded)
    differ = [stage for stage in found if found[stage] != recorded[stage]]
    assert not differ, f"the first stage that differs is {differ[0]!r}"


def test_threads_and_how_a_run_is_split_change_no_bit() -> None:
    """A trial is the same on another number of threads, and in calls of other lengths."""
    recorded = json.loads(FILE.read_text())["dual_learning"]["after 10 s"]
    simulation = build(compose_config("+experiment=dual_learning", "trials=4"))
    left = round(10_000 / simulation.tick)
    for ticks, threads in ((1, 3), (14, 2), (left - 15, 4)):
        simulation.run(make_engine("fused", "cpu", threads), ticks)
    assert state(simulation) == recorded


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    FILE.write_text(json.dumps({experiment: stages(experiment) for experiment in EXPERIMENTS}, indent=1) + "\n")
