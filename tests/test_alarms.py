"""Alarms on hand-made trials, each beside one that is well, and on a run that goes wrong."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers import compose_config, make_simulation
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import Tensor

from snnrl.recording.alarms import POINTS, Alarms
from snnrl.running.job import perform
from snnrl.simulation import Simulation

ROLES = ["food_attraction", "food_attraction", "food_avoidance", "food_avoidance"]
CONFIG = compose_config("+experiment=food_attraction").record.alarms


@pytest.fixture
def simulation() -> Simulation:
    made = make_simulation("+experiment=food_attraction", "trials=3", "trial_start=4")
    made.network.time.fill_(5000)
    return made


def watch(simulation: Simulation, **changed: Any) -> Alarms:
    return Alarms(dataclasses.replace(CONFIG, **changed), simulation, ROLES)


def weights(attraction: Tensor, avoidance: Tensor) -> Tensor:
    """[T, 3, 4] for both sides: trial 1 as given [T], the others at rest."""
    result = torch.zeros(len(attraction), 3, 4)
    result[:, 1] = torch.stack([attraction - 0.3, attraction + 0.3, avoidance, avoidance], 1)
    return result


NONE = weights(torch.zeros(1), torch.zeros(1))


def test_a_trial_whose_motor_falls_silent(simulation: Simulation) -> None:
    alarms = watch(simulation)
    network, motors = simulation.network, simulation.situation.coding.motor_groups
    network.spike_count[:, motors] += 5
    alarms.check(NONE)
    network.time += 9990
    network.spike_count[0] += 1
    network.spike_count[1, motors[0]] += 1  # but not the other motor
    assert alarms.check(NONE) == []
    network.time += 10
    network.spike_count[2] += 1
    assert alarms.check(NONE) == ["silent"]
    assert alarms.summary() == {"silent": {"first_s": 15.0, "trials": [5]}}
    assert watch(simulation, silent=None).check(NONE) == []


def test_a_trial_with_too_many_weights_at_the_upper_bound(simulation: Simulation) -> None:
    table = simulation.network.synapses
    plastic = table.trial[: table.plastic]
    most = 4.0
    for trial, share in ((0, 0.74), (1, 0.76), (2, 0.0)):
        mine = (plastic == trial).nonzero()[:, 0]
        table.weight[mine] = 0.0
        table.weight[mine[: round(share * len(mine))]] = most
    alarms = watch(simulation)
    assert alarms.check(NONE) == ["saturated"]
    assert alarms.summary() == {"saturated": {"first_s": 5.0, "trials": [5]}}
    assert alarms.explain("saturated").startswith("1 of 3 trials saturated at 5 s: more than 75 % of the plastic")
    assert watch(simulation, saturated=None).check(NONE) == []


WAVE = 2.0 + torch.sin(torch.arange(POINTS) / 3.0)


@pytest.mark.parametrize(
    ("attraction", "avoidance", "flagged"),
    [
        (WAVE, WAVE - 0.1, True),
        (WAVE, 3.5 - WAVE + 0.5, False),  # in opposition
        (WAVE, WAVE - 0.5, False),  # attraction leads
        (WAVE - 1.0, WAVE - 1.0, False),  # both weak
        (WAVE, torch.full_like(WAVE, 2.5), False),  # one at rest
        (WAVE[1:], WAVE[1:] - 0.1, False),  # too short to tell
    ],
)
def test_a_trial_whose_weights_are_synchronised(
    simulation: Simulation, attraction: Tensor, avoidance: Tensor, flagged: bool
) -> None:
    alarms = watch(simulation)
    history = weights(attraction, avoidance)
    assert alarms.check(history) == (["synchronised"] if flagged else [])
    assert alarms.summary() == ({"synchronised": {"first_s": 5.0, "trials": [5]}} if flagged else {})
    assert watch(simulation, synchronised=None).check(history) == []


@pytest.mark.parametrize("name", ["v", "u", "weight", "eligibility", "level"])
@pytest.mark.parametrize("value", [float("nan"), float("-inf")])
def test_a_trial_with_non_finite_values(simulation: Simulation, name: str, value: float) -> None:
    network = simulation.network
    assert network.dopamine is not None
    alarms = watch(simulation)
    assert alarms.check(NONE) == []
    if name in ("weight", "eligibility"):
        values = getattr(network.synapses, name)
        values[(network.synapses.trial == 1).nonzero()[-1]] = value
    else:
        (network.dopamine.level if name == "level" else getattr(network.neurons, name))[1] = value
    assert alarms.check(NONE) == ["non-finite"]
    assert alarms.check(NONE) == []  # said once
    assert alarms.summary() == {"non-finite": {"first_s": 5.0, "trials": [5]}}


def test_state_goes_on(simulation: Simulation) -> None:
    alarms = watch(simulation)
    simulation.network.neurons.v[0] = torch.nan
    alarms.check(NONE)
    simulation.network.time += 10_000
    other = Alarms(CONFIG, simulation, ROLES, alarms.state_dict())
    assert other.check(NONE) == ["silent"]
    assert other.summary()["non-finite"] == {"first_s": 5.0, "trials": [4]}


def test_a_network_that_learns_absurdly_fast(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["trials=2", "seconds=60", "threads=1", "record.pictures=0"]
    absurd = ["network.plasticity.potentiation=10", "network.homeostasis=null", "network.dopamine.baseline=0.01"]
    config = compose_config("+experiment=food_attraction", *options, *absurd)
    summary = perform(config, tmp_path)
    assert summary["alarms"]["saturated"]["trials"] == [0, 1]
    assert json.loads((tmp_path / "summary.json").read_text())["alarms"] == summary["alarms"]
    lines = [line for line in capsys.readouterr().err.splitlines() if "trials saturated at" in line]
    assert len(lines) == 1
    events = EventAccumulator(str(tmp_path)).Reload()
    marks = events.Scalars("alarms, trials/saturated")
    assert marks[-1].value == 2
    assert marks[0].step == round(summary["alarms"]["saturated"]["first_s"])
    assert "alarm: saturated/text_summary" in events.Tags()["tensors"]


def test_infinite_values_leave_a_summary(tmp_path: Path) -> None:
    config = compose_config("+experiment=food_attraction", "trials=1", "seconds=20", "threads=1", "record.pictures=20")
    config.network.dopamine.release = 1e38  # type: ignore[union-attr]
    config.network.dopamine.threshold = 0  # type: ignore[union-attr]
    summary = perform(config, tmp_path)
    assert summary["alarms"]["non-finite"]["trials"] == [0]
    assert None in summary["mean_weight"].values()
