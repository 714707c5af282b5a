"""Tasks: stimuli, coincidences and delayed reward against closed forms, and both engines against each other."""

from __future__ import annotations

import copy
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pytest
import torch
from helpers import (
    ENGINES,
    SMALL_STIMULI,
    SMALL_TASK,
    compose_config,
    forced,
    make_dopamine,
    make_group,
    make_network,
    make_projection,
    projections_of,
    run_each,
    spikes_of,
)
from torch import Tensor

from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws
from snnrl.model.network import Network
from snnrl.model.plasticity import Plasticity
from snnrl.simulation import Simulation
from snnrl.tasks.coincidences import Coincidence
from snnrl.tasks.responses import quarters
from snnrl.tasks.rewards import Reward
from snnrl.tasks.stimuli import NONE, Stimuli
from snnrl.tasks.task import Task

EXPERIMENTS = ("distal_reward", "classical_conditioning")
PUBLISHED = Plasticity(
    0.1 / 0.95, 0.15, -1 / math.log(0.95), -1 / math.log(0.95), -10 / math.log(0.99), 4.0, "depresses"
)
SMALL = [*SMALL_TASK, "dtype=float64"]


def pair(weight: float = 2.0, baseline: float = 0.0, rule: Plasticity = PUBLISHED) -> Network:
    """One plastic synapse that carries no current, in a network whose dopamine comes from outside."""
    synapse = make_projection("plastic", "pre", "post", torch.full((1, 1, 1), weight, dtype=torch.float64), rule=rule)
    dopamine = make_dopamine(baseline=baseline, tau=200.0, sources={})
    return make_network([make_group("pre", 1), make_group("post", 1)], [synapse], dopamine, gain=0.0)


def task_of(experiment: str, *overrides: str) -> Simulation[Task]:
    stimuli = SMALL_STIMULI if experiment == "classical_conditioning" else ()
    return build(compose_config(f"+experiment={experiment}", "trials=3", *SMALL, *stimuli, *overrides))


def traces(pre: list[int], post: list[int], steps: int) -> list[float]:
    """Eligibility after every ms as daspnet.m computes it: traces set to 0.1 that fall by 0.95 a ms.

    Potentiation reads the presynaptic trace of 1 ms ago, depression the postsynaptic one of now; the
    eligibility falls as it is there on average, by 0.99 in 10 ms.
    """
    eligibility, values = 0.0, []
    pre_trace = post_trace = pre_before = 0.0
    for t in range(steps):
        eligibility *= 0.99**0.1
        pre_before, pre_trace, post_trace = pre_trace, 0.95 * pre_trace, 0.95 * post_trace
        if t in pre:
            pre_trace = 0.1
        if t in post:
            post_trace = 0.1
            eligibility += pre_before
        if t in pre:
            eligibility -= 1.5 * post_trace
        values.append(eligibility)
    return values


# the same twice: A+ at a distance of 1 ms, and A+ at the arrival, which is 1 ms after the departure
SPELLED = (PUBLISHED, replace(PUBLISHED, potentiation=0.1, travel=1))


@pytest.mark.parametrize("rule", SPELLED, ids=["departure", "arrival"])
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("pre", "post"),
    [
        ([20], [27]),
        ([27], [20]),
        ([20], [21]),
        ([20], [20]),
        ([20, 70], [70]),
        ([70], [20, 70]),
        ([20, 60, 99, 140], [30, 60, 100, 139]),
        ([0, 50, 101], [0, 50, 101]),
    ],
)
def test_published_pairing_is_that_of_set_and_decaying_traces(
    pre: list[int], post: list[int], engine: str, rule: Plasticity
) -> None:
    steps = 157
    network = pair(rule=rule)
    (synapse,) = projections_of(network)
    injected = forced(network, steps, {("pre", 0): pre, ("post", 0): post})
    raster, (eligibility,) = run_each(engine, network, injected, synapse.eligibility)
    assert (spikes_of(raster, 0), spikes_of(raster, 1)) == (pre, post)
    assert eligibility[:, 0].tolist() == pytest.approx(traces(pre, post, steps), abs=1e-12)
    whole = pair(rule=rule)
    make_engine(engine, "cpu", 1).run_network(whole, injected)
    assert float(whole.synapses.eligibility) == pytest.approx(float(eligibility[-1]), abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_delayed_reward_moves_the_weight_as_in_closed_form(engine: str) -> None:
    """A pair at 20 ms, a reward r at 1100: w' = e d in every ms, with e and d decaying from there."""
    steps, tau, lasting = 1400, 200.0, PUBLISHED.tau_eligibility
    network = pair()
    injected = forced(network, steps, {("pre", 0): [15], ("post", 0): [20]})
    reward = torch.zeros(steps, 1, dtype=torch.float64)
    reward[1100] = 0.05
    make_engine(engine, "cpu", 1).run_network(network, injected, None, None, reward)
    eligibility = 0.1 * 0.95**4 * math.exp(-(1100 - 20) / lasting)
    both = math.exp(-1 / lasting - 1 / tau)
    expected = 2.0 + 0.05 * eligibility * (1 - both ** (steps - 1100)) / (1 - both)
    assert float(network.synapses.weight) == pytest.approx(expected, abs=1e-9)
    assert network.dopamine is not None
    assert float(network.dopamine.level) == pytest.approx(0.05 * math.exp(-(steps - 1 - 1100) / tau), abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_rewards_of_either_sign_add_to_the_release_of_neurons(engine: str) -> None:
    steps = 130
    network = make_network([make_group("dopaminergic", 7)], (), make_dopamine())
    injected = forced(network, steps, {("dopaminergic", k): [40] for k in range(7)})
    reward = torch.zeros(steps, 1, dtype=torch.float64)
    reward[30], reward[45], reward[101] = 0.02, 0.01, -0.05
    assert network.dopamine is not None
    machine, levels = make_engine(engine, "cpu", 1), []
    for k in range(steps):
        machine.run_network(network, injected[k : k + 1], None, None, reward[k : k + 1])
        levels.append(float(network.dopamine.level))
    bursts = oracle.dopamine([7 if t == 40 else 0 for t in range(steps)])
    given = [sum(float(reward[s]) * math.exp((s - t) / 25) for s in range(t + 1)) for t in range(steps)]
    assert levels == pytest.approx([a + b for a, b in zip(bursts, given, strict=True)], abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_reward_needs_dopamine(engine: str) -> None:
    network = make_network([make_group("only", 1)])
    with pytest.raises(ValueError, match="reward: needs a network with a modulator"):
        make_engine(engine, "cpu").run_network(network, torch.zeros(1, 1, 1).double(), reward=torch.ones(1, 1))


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_engines_agree_on_every_spike_of_a_task(experiment: str) -> None:
    options = ["task.tick=70", "task.reward.shortest=70", "task.reward.longest=300", "trials=2"]
    if experiment == "distal_reward":
        options += ["task.coincidence.window=500"]
    first = task_of(experiment, *options, "network.synapses.to_excitatory.weight=2")
    second = copy.deepcopy(first)
    first.run(make_engine("reference", "cpu"), 20)
    second.run(make_engine("fused", "cpu", 2), 20)
    assert int(first.network.spike_count.sum()) > 200
    assert int(first.situation.reward.given.sum()) > 0
    expected = first.state_dict()
    for key, value in second.state_dict().items():
        difference = (value.double() - expected[key].double()).abs()
        assert (difference <= 1e-9 * (1.0 + expected[key].double().abs())).all(), key


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_splits_and_saved_states_change_nothing_and_trials_are_their_own(experiment: str) -> None:
    first, second, alone = task_of(experiment), task_of(experiment), task_of(experiment, "trials=1", "trial_start=2")
    machine = make_engine("fused", "cpu", 1)
    first.run(machine, 25)
    second.run(machine, 11)
    third = task_of(experiment)
    third.load_state_dict(second.state_dict())
    third.run(machine, 14)
    alone.run(machine, 25)
    for key, value in third.state_dict().items():
        assert torch.equal(value, first.state_dict()[key]), key
    assert torch.equal(alone.network.spike_count[0], first.network.spike_count[2])
    assert int(alone.situation.reward.given[0]) == int(first.situation.reward.given[2])
    assert torch.equal(alone.network.neurons.v[0], first.network.neurons.v[2])


def test_every_neuron_has_the_fan_out_it_is_given() -> None:
    network = task_of("distal_reward").network
    expected = {"excitatory_to_excitatory": 40, "excitatory_to_inhibitory": 10, "inhibitory_to_excitatory": 50}
    for name, fan_out in expected.items():
        projection = network.projections[name]
        joined = torch.zeros(projection.shape, dtype=torch.int64)
        joined.index_put_(
            (projection.trial, projection.pre_index, projection.post_index), torch.tensor(1), accumulate=True
        )
        assert joined.max() == 1
        assert (joined.sum(2) == fan_out).all()
        fan_in = joined.sum(1).double()
        targets = projection.shape[2]
        spread = math.sqrt(projection.shape[1] * (fan_out / targets) * (1 - fan_out / targets))
        assert float(fan_in.std()) == pytest.approx(spread, rel=0.25)  # targets are drawn uniformly
        assert len(joined.flatten(1).unique(dim=0)) == 3  # every trial its own


def rewards_of(reward: Reward, promised: dict[int, int], steps: int, tick: int) -> Tensor:
    """All rewards [steps, B] when trial `promised[t]` earns one at t, tick by tick as a task does."""
    draws, given = Draws(3, torch.arange(2)), []
    for start in range(0, steps, tick):
        times = start + torch.arange(tick)
        given.append(reward.take(times))
        earned = torch.zeros(tick, 2, dtype=torch.bool)
        for t, trial in promised.items():
            if start <= t < start + tick:
                earned[t - start, trial] = True
        reward.promise(earned, draws, times)
    return torch.cat(given)


def test_a_reward_comes_once_after_its_delay() -> None:
    exact = rewards_of(Reward(0.5, 30, 30, 10, torch.arange(2)), {3: 0, 17: 1, 18: 1}, 100, 10)
    assert [tuple(row) for row in exact.nonzero().tolist()] == [(33, 0), (47, 1), (48, 1)]
    assert exact.sum() == 1.5
    reward = Reward(1.0, 10, 39, 10, torch.arange(2))
    spread = rewards_of(reward, dict.fromkeys(range(500), 0), 600, 10)
    assert spread.sum() == 500 == int(reward.given[0])
    mean_delay = float((spread[:, 0] * torch.arange(600)).sum()) / 500 - 249.5
    assert mean_delay == pytest.approx(24.5, abs=2.0)
    assert spread[:10, 0].sum() == 0
    assert spread[539:, 0].sum() == 0


def test_stimuli_come_at_random_and_only_their_neurons_are_pulsed() -> None:
    draws = Draws(1, torch.arange(4))
    members = torch.stack([torch.tensor([[0, 1], [2, 3], [4, 5]]) + k for k in range(4)])
    stimuli = Stimuli(members, 7.0, 100, 300, 10, 0)
    onsets: list[list[int]] = [[] for _ in range(4)]
    shown = torch.zeros(3, dtype=torch.int64)
    for start in range(0, 21_000, 70):
        times = start + torch.arange(70)
        begins = stimuli.schedule(draws, times)
        current = torch.zeros(70, 4, 9, dtype=torch.float64)
        stimuli.add_pulses(begins, current)
        assert float(current.sum()) == 2 * 7.0 * int((begins != NONE).sum())
        for row, trial in (begins != NONE).nonzero().tolist():
            which = int(begins[row, trial])
            shown[which] += 1
            onsets[trial].append(start + row)
            assert current[row, trial].nonzero()[:, 0].tolist() == members[trial, which].tolist()
    for times_of in onsets:
        gaps = np.diff(times_of)
        assert gaps.min() >= 100
        assert gaps.max() <= 300
        assert gaps.mean() == pytest.approx(200, abs=25)
    assert len({tuple(times_of) for times_of in onsets}) == 4
    assert (shown.double() / shown.sum() - 1 / 3).abs().max() < 0.1


def test_response_counts_spikes_of_the_window_across_ticks() -> None:
    stimuli = Stimuli(torch.zeros(1, 2, 1, dtype=torch.int64), 1.0, 20, 20, 5, 0)
    begins = torch.full((40, 1), NONE)
    begins[8], begins[28] = 1, 0
    fired = torch.zeros(40, 1, 3, dtype=torch.bool)
    fired[[8, 9, 13], 0, 0] = True  # the pulse's own ms, then two answers
    fired[[13, 14, 27, 28], 0, 1] = True  # one answer
    fired[[29, 33, 34], 0, 2] = True  # two answers
    for start in range(0, 40, 10):
        part = slice(start, start + 10)
        stimuli.respond(begins[part], fired[part], start + torch.arange(10))
    assert stimuli.response.tolist() == [[2, 3]]
    assert stimuli.presented.tolist() == [[1, 1]]


def test_coincidence_is_a_post_spike_soon_after_a_pre_spike() -> None:
    network = pair()
    coincidence = Coincidence(network, "plastic", 20, 0.25)
    assert network.synapses.weight.tolist() == [0.25]
    fired = torch.zeros(120, 1, 2, dtype=torch.bool)
    fired[[5, 40, 60, 99], 0, 0] = True
    fired[[4, 6, 24, 25, 40, 61, 100, 118, 119], 0, 1] = True
    found = []
    for start in range(0, 120, 10):
        part = coincidence.observe(network, fired[start : start + 10], start + torch.arange(10))
        found += [start + k for k in part[:, 0].nonzero()[:, 0].tolist()]
    assert found == [6, 24, 61, 100, 118]
    assert int(coincidence.count) == 5


def test_the_watched_synapse_is_one_of_its_projection_in_its_trial() -> None:
    simulation = task_of("distal_reward", "task.coincidence.projection=excitatory_to_inhibitory")
    network, coincidence = simulation.network, simulation.situation.coincidence
    assert coincidence is not None
    projection = network.projections["excitatory_to_inhibitory"]
    projection.weight.add_(100.0)
    assert (network.synapses.weight[coincidence.synapse] == 100.0).all()
    assert network.synapses.trial[coincidence.synapse].tolist() == [0, 1, 2]


def run_command(folder: Path, *arguments: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "snnrl.run", *arguments, "hydra.run.dir=here", "trials=2"]
    done = subprocess.run(command, cwd=folder, env=os.environ, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads((folder / "here" / "summary.json").read_text())
    assert isinstance(result, dict)
    return result


def test_distal_reward_reinforces_one_synapse(tmp_path: Path) -> None:
    """A small network with larger rewards after shorter delays, so that a few of them are enough."""
    options = ["seconds=80", "record.every=4", "task.reward.amount=0.2"]
    options += ["task.reward.shortest=101", "task.reward.longest=500"]
    summary = run_command(tmp_path, "+experiment=distal_reward", *SMALL, *options)
    series = np.load(tmp_path / "here" / "series.npz")
    assert summary["results"]["rewards"] == series["rewards"][-1].mean()
    assert (np.diff(series["rewards"], axis=0) >= 0).all()
    assert series["chosen_weight"].shape == series["mean_weight"].shape == (21, 2)
    assert (series["chosen_weight"][0] == 0.0).all()
    assert (series["mean_weight"][0] == 1.0).all()
    assert (series["histogram"].sum(1) == 80 * 50 - 1).all()
    assert (series["chosen_weight"][-1] > 3.0).all()
    assert (series["mean_weight"][-1] < 1.5).all()
    image = (tmp_path / "here" / "reinforcement.png").read_bytes()
    assert image.startswith(b"\x89PNG")
    assert len(image) > 10_000


def test_a_synapse_that_cannot_learn_is_recorded_too(tmp_path: Path) -> None:
    options = ["robot=learning_disabled", "seconds=3", "record.every=1", "record.tensorboard=false"]
    summary = run_command(tmp_path, "+experiment=distal_reward", *SMALL, *options)
    assert summary["robot"] == "learning_disabled"
    assert summary["results"]["chosen_weight"] == 0.0
    assert (tmp_path / "here" / "reinforcement.png").exists()


def test_conditioning_records_responses(tmp_path: Path) -> None:
    options = ["seconds=20", "record.every=1", "record.tensorboard=false"]
    summary = run_command(tmp_path, "+experiment=classical_conditioning", *SMALL, *SMALL_STIMULI, *options)
    series = np.load(tmp_path / "here" / "series.npz")
    assert series["presented"].shape == series["response"].shape == (21, 2, 5)
    shown = series["presented"][-1].sum(1)
    assert shown == pytest.approx(20_000 / 200, rel=0.15)
    rewarded = series["presented"][-1][:, 0]
    assert (np.abs(series["rewards"][-1] - rewarded) <= 6).all()  # but for those still on their way
    last = quarters(dict(series))[1]
    assert summary["results"]["response_last"] == pytest.approx(last[:, 0].mean())
    assert (tmp_path / "here" / "conditioning.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("experiment", "override", "message"),
    [
        ("distal_reward", "task.reward.shortest=50", "task.reward.shortest=50: must be at least task.tick=100"),
        ("distal_reward", "task.reward.longest=900", "task.reward.shortest=1001: must be at most task.reward.longest"),
        ("distal_reward", "task.coincidence.projection=inhibitory_to_excitatory", "must be one of excitatory_to_"),
        ("distal_reward", "task.coincidence.weight=5", "task.coincidence.weight=5.0: must be in [0, 4]"),
        ("distal_reward", "task.coincidence=null", "task.stimuli=None: a task needs stimuli or a coincidence"),
        ("distal_reward", "network.dopamine=null", "network.dopamine=None: must be given for a task"),
        ("distal_reward", "network.synapses.inhibition.fan_out=801", "fan_out=801: must be at most 800, the size of"),
        ("distal_reward", "network.synapses.inhibition.fan_out=null", "either probability or fan_out must be given"),
        ("distal_reward", "network.synapses.inhibition.probability=0.1", "either probability or fan_out must be"),
        ("distal_reward", "network.plasticity.simultaneous=odd", "simultaneous=odd: must be one of potentiates, dep"),
        ("distal_reward", "+experiment.correct.food=together", "is for robots, not for tasks"),
        ("distal_reward", "coding=food_only", "coding=...: must be null where there is a task"),
        ("classical_conditioning", "task.stimuli.groups=[odd]", "task.stimuli.groups=odd: must be one of excit"),
        ("classical_conditioning", "task.stimuli.size=1001", "task.stimuli.size=1001: must be at most 1000"),
        ("classical_conditioning", "task.stimuli.shortest=400", "shortest=400: must be at most task.stimuli.longest"),
        ("classical_conditioning", "task.stimuli.window=100", "window=100: must be less than task.stimuli.shortest"),
        ("classical_conditioning", "task.stimuli.rewarded=100", "rewarded=100: must be less than count=100"),
    ],
)
def test_bad_tasks_are_refused_by_name(experiment: str, override: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(compose_config(f"+experiment={experiment}", "trials=1", override))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_robots_and_tasks_are_not_mixed_up() -> None:
    with pytest.raises(ConfigError, match=r"coding=.*: must be null where there is a task"):
        build(compose_config("+experiment=food_attraction", "task=distal_reward"))
    with pytest.raises(ConfigError, match="coding=None: must be given where there is no task"):
        build(compose_config("+experiment=distal_reward", "~task"))
    with pytest.raises(ConfigError, match="world=None: must be given where there is no task"):
        build(compose_config("+experiment=food_attraction", "~world"))
