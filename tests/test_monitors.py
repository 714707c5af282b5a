"""Monitors see what is there, on every engine, and change nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import (
    ENGINES,
    SMALL_TASK,
    SURE,
    compose_config,
    forced,
    make_dopamine,
    make_group,
    make_network,
    make_projection,
    run_each,
)

from snnrl import record, run_network, run_simulation
from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.engines.watched import WatchedEngine
from snnrl.model.network import Network
from snnrl.recording.monitors import Monitor
from snnrl.recording.recorder import Recorder
from snnrl.running import job
from snnrl.running.job import perform
from snnrl.schema import CheckpointConfig, ConfigError
from snnrl.simulation import Simulation

TRIALS, STEPS = 3, 120
FINE = {  # within a tick of 70 ms, and some at its end
    "motors": "{of: left_motor, quantities: [v, u, spikes], neurons: [0, 3], trials: [5, 4], every: 7}",
    "dopamine": "{of: dopamine, quantities: [level], every: 10}",
    "reflex": "{of: left_food_to_right_motor, quantities: [weight, eligibility], pre: [2, 1], trials: [5], every: 35}",
}


def network() -> Network:
    """Two cells onto three, one pair of which has no synapse, and dopamine."""
    groups = [make_group("cue", 2, TRIALS), make_group("out", 3, TRIALS), make_group("dopaminergic", 7, TRIALS)]
    weight = torch.full((TRIALS, 2, 3), 2.0, dtype=torch.float64)
    weight[:, 1, 0] = torch.nan
    weight[1, 0, 0] = torch.nan
    return make_network(groups, [make_projection("p", "cue", "out", weight)], make_dopamine(TRIALS))


def current(network: Network) -> torch.Tensor:
    spikes: dict[tuple[str, int], list[int]] = {("cue", 0): [10, 50], ("cue", 1): [12, 90], ("out", 2): [15, 53]}
    reward = {("dopaminergic", k): [40, 80] for k in range(7)}
    injected = forced(network, STEPS, spikes | reward, trial=1)
    injected[20, 2, 1] = SURE
    return injected


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_seen_is_what_was_there(engine: str) -> None:
    net, other = network(), network()
    synapses = net.synapses
    v, u = net.neurons.v[:, 2:5], net.neurons.u[:, 2:5]
    watched = (v, u, synapses.weight, synapses.eligibility, net.modulators["dopamine"].level)
    fired, (v, u, weight, eligibility, level) = run_each(engine, net, current(net), *watched)
    cells, wires, dopamine = run_network(
        other,
        current(other),
        [
            record(other, "out", ["v", "u", "spikes"], neurons=[2, 0], trials=[1]),
            record(other, "p", ["weight", "eligibility"], trials=[2, 1]),
            record(other, "dopamine", "level", every=20),
        ],
        engine=engine,
    )
    assert cells.time.tolist() == list(range(1, STEPS + 1))
    assert dopamine.time.tolist() == [20, 40, 60, 80, 100, 120]
    assert cells["v"].shape == (STEPS, 1, 2)
    np.testing.assert_array_equal(cells["v"][:, 0], v[:, 1][:, [2, 0]])
    np.testing.assert_array_equal(cells["u"][:, 0], u[:, 1][:, [2, 0]])
    np.testing.assert_array_equal(dopamine["level"], level[19::20])
    for name, values in (("weight", weight), ("eligibility", eligibility)):
        dense = np.full((STEPS, TRIALS, 2, 3), np.nan)
        dense[:, synapses.trial, net.projections["p"].pre_index, net.projections["p"].post_index] = values
        np.testing.assert_array_equal(wires[name], dense[:, [2, 1]])
    assert np.ptp(wires["weight"][:, 1, 0, 2]) > 0.01
    time, neuron = fired[:, 1, 2:5].nonzero().numpy().T
    shown = np.isin(neuron, [0, 2])
    expected = {(t, 1, n) for t, n in zip(time[shown], neuron[shown], strict=True)}
    assert set(map(tuple, cells["spikes"].tolist())) == expected
    assert 2 in cells["spikes"][:, 2]


def seen(simulation: Simulation[Any]) -> list[Monitor]:
    config = compose_config("+experiment=food_attraction", *(f"+record.monitors.{k}={v}" for k, v in FINE.items()))
    return job.monitors_of(simulation.network, config.record.monitors)


def robot(*overrides: str) -> Simulation[Any]:
    return build(compose_config("+experiment=food_attraction", "trials=2", "trial_start=4", *overrides))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_robot_that_is_watched_is_the_same_robot(engine: str, dtype: str) -> None:
    ticks = 12 if engine == "reference" else 100
    alone, watched = robot(f"dtype={dtype}"), robot(f"dtype={dtype}")
    raster = torch.zeros(ticks * 70, 2, alone.network.size, dtype=torch.bool)
    shown = torch.zeros(ticks * 70, 1, alone.network.size, dtype=torch.bool)
    alone.run(make_engine(engine, "cpu", 1), ticks, raster)
    motors, dopamine, reflex = monitors = seen(watched)
    watched.run(WatchedEngine(make_engine(engine, "cpu", 1), monitors), ticks, shown)
    for key, values in alone.state_dict().items():
        assert torch.equal(watched.state_dict()[key], values), key
    assert torch.equal(shown, raster[:, :1])
    assert motors.time.tolist() == list(range(7, 70 * ticks + 1, 7))
    group = alone.network.groups["left_motor"]
    of_trial_5 = raster[:, 1, group.span][:, [0, 3]].nonzero()
    spikes = motors["spikes"]
    assert spikes[spikes[:, 1] == 5][:, 0].tolist() == of_trial_5[:, 0].tolist()
    assert len(spikes) > 3
    np.testing.assert_allclose(motors["v"][-1, ::-1], group.v[:, [0, 3]], rtol=1e-4)
    np.testing.assert_allclose(dopamine["level"][-1], alone.network.modulators["dopamine"].level, rtol=1e-5)
    dense = alone.network.projections["left_food_to_right_motor"].matrix().to_dense()[1, [2, 1]]
    np.testing.assert_allclose(np.nan_to_num(reflex["weight"][-1, 0]), dense, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_task_that_is_watched_is_the_same_task(engine: str) -> None:
    options = ("+experiment=distal_reward", *SMALL_TASK, "trials=2")
    alone, watched = (build(compose_config(*options)) for _ in range(2))
    alone.run(make_engine(engine, "cpu", 1), 4)
    cells = record(watched.network, "inhibitory", ["v", "spikes"], every=30)
    rough = record(watched.network, "dopamine", "level", every=200)
    run_simulation(watched, 0.4, [cells, rough], engine=engine)
    for key, values in alone.state_dict().items():
        assert torch.equal(watched.state_dict()[key], values), key
    assert cells.time.tolist() == list(range(30, 401, 30))
    assert rough.time.tolist() == [200, 400]
    assert len(cells["spikes"]) == int(alone.network.spike_count[:, 1].sum()) > 0


def test_a_monitor_of_spikes_alone_does_not_look() -> None:
    simulation = robot()
    [spikes] = run_simulation(simulation, 7.0, [record(simulation.network, "dopaminergic", "spikes")])
    assert len(spikes.time) == 0
    count = simulation.network.spike_count[:, list(simulation.network.groups).index("dopaminergic")]
    assert [int((spikes["spikes"][:, 1] == trial).sum()) for trial in (4, 5)] == count.tolist()
    assert (np.diff(spikes["spikes"][:, 0]) >= 0).all()


OPTIONS = (
    "+experiment=food_attraction",
    "trials=2",
    "trial_start=4",
    "seconds=2.8",
    "record.every=1.4",
    "record.tensorboard=false",
)


def test_a_run_keeps_what_its_monitors_see_and_goes_on_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watched = compose_config(*OPTIONS, "threads=1", *(f"+record.monitors.{k}={v}" for k, v in FINE.items()))
    plain, whole, parts = (tmp_path / name for name in ("plain", "whole", "parts"))
    for folder in (plain, whole, parts):
        folder.mkdir()
    perform(compose_config(*OPTIONS, "threads=1"), plain)
    perform(watched, whole)
    assert (plain / "series.npz").read_bytes() == (whole / "series.npz").read_bytes()
    assert not (plain / "monitors.npz").exists()
    simulation = robot()
    monitors = run_simulation(simulation, 2.8, seen(simulation))
    with np.load(whole / "monitors.npz") as kept:
        assert set(kept) == {f"{monitor.name}/{key}" for monitor in monitors for key in monitor.arrays()}
        for monitor in monitors:
            for key, values in monitor.arrays().items():
                np.testing.assert_array_equal(kept[f"{monitor.name}/{key}"], values)
    saved = replace(watched, checkpoint=CheckpointConfig(every=1.4))
    with monkeypatch.context() as patch:
        patch.setattr(job, "_record", interrupted_after(1.4, job._record))
        with pytest.raises(KeyboardInterrupt):
            perform(saved, parts)
    assert (parts / "checkpoint.pt").exists()
    perform(saved, parts)
    assert (parts / "monitors.npz").read_bytes() == (whole / "monitors.npz").read_bytes()


def interrupted_after(seconds: float, then: Callable[..., None]) -> Callable[..., None]:
    """In place of `job._record`: goes no further than that."""

    def record(recorder: Recorder, *arguments: Any) -> None:
        if recorder.simulation.seconds > seconds:
            raise KeyboardInterrupt
        then(recorder, *arguments)

    return record


NAMES = "cue, out, dopaminergic, p, dopamine"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"of": "motor"}, f"of=motor: must be a group, projection or modulator: {NAMES}"),
        ({"of": "out", "quantities": "weight"}, "quantities=weight: of out must be one of v, u, spikes"),
        ({"of": "p", "quantities": ["weight", "spikes"]}, "quantities=spikes: of p must be one of weight, eligibility"),
        ({"of": "dopamine", "quantities": "v"}, "quantities=v: of dopamine must be one of level"),
        ({"of": "out", "quantities": []}, "quantities=: of out must be one of v, u, spikes"),
        ({"of": "out", "neurons": [0, 3]}, "neurons=3: must be among 0 to 2"),
        ({"of": "out", "neurons": [1, 1]}, r"neurons=\[1, 1\]: must name at least one, each once"),
        ({"of": "out", "pre": [1]}, r"pre=\[1\]: out has neurons"),
        ({"of": "dopamine", "quantities": "level", "neurons": [1]}, r"neurons=\[1\]: dopamine has none"),
        ({"of": "p", "quantities": "weight", "post": [-1]}, "post=-1: must be among 0 to 2"),
        ({"of": "out", "trials": [3]}, "trials=3: must be among 0 to 2"),
        ({"of": "out", "every": 0}, "every=0: must be at least 1 ms"),
    ],
)
def test_what_is_not_there_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^{message}$"):
        record(network(), **{"quantities": "v", **arguments})


def test_a_monitor_of_another_network_is_refused() -> None:
    net = network()
    with pytest.raises(ValueError, match="monitors: out is of another network"):
        run_network(net, current(net), [record(network(), "out", "v")])


@pytest.mark.parametrize(
    ("monitor", "message"),
    [
        ("{of: motor, quantities: [v]}", "record.monitors.mine.of=motor: must be a group"),
        ("{of: left_motor, quantities: [v], trials: [2]}", "record.monitors.mine.trials=2: must be among 4 to 5"),
        ("{of: left_motor, quantities: [v], every: 0}", "record.monitors.mine.every=0: must be at least 1"),
        ("{of: left_motor, quantities: [v], neurons: [x]}", r"record.monitors.mine.neurons=x: must be a whole number"),
        ("{of: left_motor}", r"record.monitors.mine.quantities=\?\?\?: a value must be given"),
    ],
)
def test_a_run_with_a_monitor_of_nothing_is_refused(monitor: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        perform(compose_config(*OPTIONS, f"+record.monitors.mine={monitor}"), tmp_path)
    assert not list(tmp_path.iterdir())


def test_more_than_there_is_room_for_is_refused(tmp_path: Path) -> None:
    monitor = "{of: left_food_to_right_motor, quantities: [weight, eligibility]}"
    with pytest.raises(ConfigError, match=r"record.monitors.mine.every=.* GiB: needs .* of memory"):
        perform(
            compose_config(*OPTIONS, "seconds=1e8", "record.every=1e6", f"+record.monitors.mine={monitor}"), tmp_path
        )
