"""What is read of a simulation, and that one more probe is one function and one entry."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import SMALL_STIMULI, SMALL_TASK, compose_config, make_simulation
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch import Tensor

from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.recording.board import Board
from snnrl.recording.kept import kept_of
from snnrl.recording.logger import About
from snnrl.recording.probes import PROBES, Moment, Probe, counts, followed, probes_of
from snnrl.recording.recorder import Recorder
from snnrl.simulation import Simulation

CASES = {
    "robot": ["+experiment=dual_learning", "trials=3"],
    "robot without dopamine": ["+experiment=food_attraction", "trials=3", "network.dopamine=null"],
    "watched synapse": ["+experiment=distal_reward", *SMALL_TASK, "trials=3"],
    "stimuli": ["+experiment=classical_conditioning", *SMALL_TASK, *SMALL_STIMULI, "trials=3"],
}


def moment(simulation: Simulation[Any], ticks: int = 10) -> Moment:
    """After some ticks, the sample before at the start."""
    before = counts(simulation)
    simulation.run(make_engine("fused", "cpu", 1), ticks)
    return Moment(simulation, {key: values - before[key] for key, values in counts(simulation).items()})


@pytest.mark.parametrize("case", CASES)
def test_what_is_read_has_the_shape_that_is_said(case: str) -> None:
    simulation = make_simulation(*CASES[case])
    sizes = {"trial": 3, "group": len(simulation.network.groups), "projection": len(followed(simulation))}
    sizes |= {"stimulus": 5, "axis": 2}
    seen = moment(simulation)
    for probe in probes_of(simulation):
        expected = [sizes[name] for name in probe.dims]
        value = probe.read(seen)
        assert list(value.shape) == expected, probe.name
        if probe.tag:
            assert len(probe.tags(simulation)) == (expected[1] if len(expected) == 2 else 1)


def test_every_probe_applies_to_some_situation_and_has_a_name_of_its_own_there() -> None:
    applied = set()
    for options in CASES.values():
        probes = probes_of(make_simulation(*options))
        applied |= set(probes)
        assert len({probe.name for probe in probes}) == len(probes)
    assert applied == set(PROBES)


def test_rates_are_of_the_time_since_the_sample_before() -> None:
    simulation = make_simulation("+experiment=food_attraction", "trials=3")
    moment(simulation, 20)
    network, world = simulation.network, simulation.situation.world
    spikes, touches = network.spike_count.clone(), world.touches.clone()
    total = network.dopamine.total.clone()  # type: ignore[union-attr]
    seen = moment(simulation, 10)
    values = {probe.name: probe.read(seen) for probe in probes_of(simulation)}
    sizes = torch.tensor([group.size for group in network.groups.values()])
    torch.testing.assert_close(values["firing_rate"], ((network.spike_count - spikes) / sizes / 0.7).float())
    torch.testing.assert_close(values["collection_rate"], ((world.touches - touches)[:, 0] / 0.7).float())
    torch.testing.assert_close(values["dopamine"], ((network.dopamine.total - total) / 700).float())  # type: ignore[union-attr]
    assert float(values["time"]) == pytest.approx(2.1)


def potential(moment: Moment) -> Tensor:
    return moment.simulation.network.neurons.v.mean(1)


def test_one_more_probe_is_one_function_and_one_entry(tmp_path: Path) -> None:
    config = compose_config("+experiment=food_attraction", "trials=2", "record.every=1")
    simulation = build(config)
    kept = kept_of(simulation, config.experiment.correct)
    own = Probe("potential", potential, ("trial",), "mV", tag="mine/potential, mV")
    kept = dataclasses.replace(kept, probes=(*kept.probes, own))
    recorder = Recorder(simulation, kept, config.record, About(tmp_path), loggers={"board": Board()})
    expected = []
    for _ in range(3):
        simulation.run(make_engine("fused", "cpu", 1), 15)
        recorder.sample()
        expected.append(simulation.network.neurons.v.mean(1).numpy().copy())
    recorder.save()
    with np.load(tmp_path / "series.npz") as series:
        np.testing.assert_array_equal(series["potential"], expected)
    events = EventAccumulator(str(tmp_path)).Reload().Scalars("mine/potential, mV")
    assert [event.value for event in events] == pytest.approx(np.mean(expected, 1).tolist())
