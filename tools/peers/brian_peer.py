"""The same network in Brian2, made from a network's own tables; the mapping is in docs/conformance.md.

All trials of a batch are neurons of one Brian2 network.
"""

from __future__ import annotations

import gc
import logging
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from recording import Run
from torch import Tensor

from snnrl.model.network import Network

if "ptp" not in vars(np.ndarray):
    # Brian2 2.9, the last for Python 3.11, looks at import for a method that NumPy 2.4 has dropped
    gc.get_referents(vars(np.ndarray))[0]["ptp"] = np.ptp
import brian2

logging.getLogger("brian2").setLevel(logging.ERROR)

MEMBRANE = """
inflow = arriving + background(t, i) + injected(t, i)
v += 0.5 * (0.04 * v * v + 5.0 * v + 140.0 - u + inflow)
v += 0.5 * (0.04 * v * v + 5.0 * v + 140.0 - u + inflow)
u += a * (b * v - u)
arriving = 0
"""
NEURON = """
v : 1
u : 1
a : 1
b : 1
c : 1
d : 1
arriving : 1
level : 1
modulator_level : 1 (linked)
"""
MODULATOR = """
dlevel/dt = (baseline - level) / tau : 1
arrived : 1
"""
PLASTIC = """
w : 1
sent : 1
deligibility/dt = -eligibility / tau_eligibility : 1 (clock-driven)
dgain/dt = -gain / tau_plus : 1 (event-driven)
dloss/dt = -loss / tau_minus : 1 (event-driven)
"""
ARRIVE, LEVEL, SHARE, FIRST, SECOND, WEIGHT, HOMEOSTASIS = range(7)  # homeostasis takes three places
LATCH, SEND = 9, 10
# What a presynaptic spike does, its turn and that of a postsynaptic one in the same ms. v is reset only after the
# synapses' turn, so v < 30 says that a neuron has not fired in this step
PAIRS = {
    "potentiates": ("eligibility -= loss * int(v_post < 30); gain = potentiation", FIRST, SECOND),
    "depresses": ("eligibility -= loss; gain = potentiation", SECOND, FIRST),
}


@dataclass
class Course:
    """What one trial did: spikes [n, 2] (ms, neuron), and the values after every `every` ms, [T / every, ...]."""

    spikes: np.ndarray
    eligibility: np.ndarray
    weight: np.ndarray
    level: np.ndarray


@dataclass
class Description:
    """A Brian2 network, not yet run, and what is read from it."""

    simulation: brian2.Network
    plastic: brian2.Synapses
    modulator: brian2.NeuronGroup
    spikes: brian2.SpikeMonitor

    def fired(self) -> np.ndarray:
        """Spikes [n, 2] (ms, neuron), ordered."""
        fired = np.stack([np.round(self.spikes.t / brian2.ms).astype(int), np.array(self.spikes.i)], 1)
        return fired[np.lexsort((fired[:, 1], fired[:, 0]))]


def describe(network: Network, injected: Tensor) -> Description:
    """The network in its present state (at ms 0), all trials side by side, driven by `injected` [T, B, N]."""
    table, dopamine, rule = network.synapses, network.dopamine, network.learning()[0].rule
    trials = network.trials
    assert int(network.time) == 0
    assert dopamine is not None
    ms = brian2.ms
    brian2.defaultclock.dt = 1 * ms
    background = network.background(torch.arange(len(injected)))
    values = {
        "background": brian2.TimedArray(background.flatten(1).numpy(), dt=ms),
        "injected": brian2.TimedArray(injected.flatten(1).numpy(), dt=ms),
        "baseline": dopamine.baseline,
        "release": dopamine.values["release"],
        "tau": dopamine.tau * ms,
        "threshold": dopamine.values["threshold"],
        "tau_eligibility": rule.tau_eligibility * ms,
        "tau_plus": rule.tau_plus * ms,
        "tau_minus": rule.tau_minus * ms,
        "potentiation": rule.potentiation,
        "depression": rule.depression,
        "weight_max": rule.weight_max,
        "synaptic_gain": network.synaptic_gain,
    }
    sets = list(network.homeostasis.values())
    excess = "".join(f"excess{k} : 1 (linked)\nlower{k} : 1\n" for k in range(len(sets)))
    neurons = brian2.NeuronGroup(
        trials * network.size,
        NEURON + excess,
        threshold="v >= 30",
        reset="v = c; u += d",
        method="exact",
        namespace=values,
    )
    for key in ("v", "u", "a", "b", "c", "d"):
        setattr(neurons, key, getattr(network.neurons, key).flatten().numpy())
    neurons.run_regularly(MEMBRANE, when="groups")
    trial_of = np.repeat(np.arange(trials), network.size)
    modulator = brian2.NeuronGroup(trials, MODULATOR, method="exact", namespace=values)
    modulator.level = dopamine.level.numpy()
    modulator.run_regularly(
        "level += release * arrived * int(arrived > threshold); arrived = 0", when="synapses", order=LEVEL
    )
    neurons.modulator_level = brian2.linked_var(modulator, "level", index=trial_of)
    neurons.run_regularly("level = modulator_level", when="synapses", order=SHARE)
    source = network.groups[dopamine.sources["count"]].span
    release = brian2.Synapses(neurons, modulator, on_pre="arrived_post += 1", delay=dopamine.delay * ms)
    places = np.arange(trials)[:, None] * network.size + np.arange(source.start, source.stop)
    release.connect(i=places.flatten(), j=trial_of[places].flatten())
    release.pre.order = ARRIVE
    members = [neurons, modulator, release]

    count = table.plastic
    pre, post, delay = (part.numpy() for part in (table.pre, table.post, table.delay))
    member = "".join(f"member{k} : 1 (constant)\n" for k in range(len(sets)))
    pair, pre_turn, post_turn = PAIRS[rule.simultaneous]
    plastic = brian2.Synapses(
        neurons,
        neurons,
        PLASTIC + member,
        on_pre={
            "pair": pair,
            "latch": "sent = w",
            "send": "arriving_post += sent * synaptic_gain",
        },
        on_post="eligibility += gain; loss = depression",
        method="exact",
        namespace=values,
    )
    plastic.connect(i=pre[:count], j=post[:count])
    plastic.w = table.weight[:count].numpy()
    plastic.send.delay = (delay[:count] - 1) * ms
    plastic.pair.order, plastic.post.order, plastic.latch.order, plastic.send.order = pre_turn, post_turn, LATCH, SEND
    plastic.run_regularly("w = clip(w + eligibility * level_post, 0, weight_max)", when="synapses", order=WEIGHT)
    members.append(plastic)
    if count < len(pre):
        fixed = brian2.Synapses(
            neurons, neurons, "w : 1", on_pre="arriving_post += w * synaptic_gain", namespace=values
        )
        fixed.connect(i=pre[count:], j=post[count:])
        fixed.w = table.weight[count:].numpy()
        fixed.pre.delay = (delay[count:] - 1) * ms
        fixed.pre.order = SEND
        members.append(fixed)
    for k in range(len(sets)):
        members += _dampening(network, k, neurons, plastic, trial_of)
    spikes = brian2.SpikeMonitor(neurons)
    return Description(brian2.Network(*members, spikes), plastic, modulator, spikes)


def _dampening(
    network: Network, k: int, neurons: brian2.NeuronGroup, plastic: brian2.Synapses, trial_of: np.ndarray
) -> list[brian2.BrianObject]:
    """The k-th homeostatic set: its weights are summed per trial, and lowered where the sum is too high."""
    homeostasis = list(network.homeostasis.values())[k]
    parts, start = [], 0
    for projection in network.projections.values():
        stop = start + len(projection.weight)
        if projection.name in homeostasis.projections:
            parts.append(np.arange(start, stop))
        start = stop
    chosen = np.concatenate(parts)
    total = brian2.NeuronGroup(network.trials, "total : 1\nlimit : 1 (constant)\nexcess = int(total > limit) : 1")
    total.limit = (homeostasis.limit * network.set_size(homeostasis)).numpy()
    total_of = brian2.Synapses(plastic, total, "total_post = w_pre : 1 (summed)")
    total_of.connect(i=chosen, j=network.synapses.trial[chosen].numpy())
    adding = total_of.summed_updaters["total_post"]
    adding.when, adding.order = "synapses", HOMEOSTASIS
    setattr(neurons, f"excess{k}", brian2.linked_var(total, "excess", index=trial_of))
    neurons.run_regularly(f"lower{k} = excess{k}", when="synapses", order=HOMEOSTASIS + 1)
    belongs = np.zeros(network.synapses.plastic)
    belongs[chosen] = 1.0
    setattr(plastic, f"member{k}", belongs)
    plastic.run_regularly(
        f"w = clip(w - {homeostasis.step!r} * member{k} * lower{k}_post, 0, w)",
        when="synapses",
        order=HOMEOSTASIS + 2,
    )
    return [total, total_of]


def simulate(network: Network, injected: Tensor, every: int = 1) -> Course:
    """The network's only trial through all rows of `injected` [T, 1, N], from its present state (at ms 0)."""
    assert network.trials == 1
    brian2.prefs.codegen.target = "numpy"
    brian2.prefs.codegen.loop_invariant_optimisations = False  # which reorders sums, and so rounds differently
    described = describe(network, injected)
    clock = brian2.Clock(dt=every * brian2.ms)
    synapses = brian2.StateMonitor(described.plastic, ["eligibility", "w"], record=True, clock=clock, when="start")
    level = brian2.StateMonitor(described.modulator, "level", record=0, clock=clock, when="start")
    described.simulation.add(synapses, level)
    described.simulation.run((len(injected) + 1) * brian2.ms)  # one step more, whose start is the last one's end
    fired = described.fired()
    return Course(
        fired[fired[:, 0] < len(injected)], synapses.eligibility.T[1:], synapses.w.T[1:], level.level[0][1:, None]
    )


def standalone(network: Network, injected: Tensor, threads: int, folder: Path) -> Callable[[], Run]:
    """The network as a C++ program, with OpenMP if there is more than one thread; each call runs it from the start."""
    brian2.set_device("cpp_standalone", build_on_run=False, directory=None)
    brian2.device.reinit()
    brian2.device.activate(build_on_run=False, directory=None)
    brian2.prefs.devices.cpp_standalone.openmp_threads = threads if threads > 1 else 0
    described = describe(network, injected)
    described.simulation.run(len(injected) * brian2.ms)
    brian2.device.build(directory=str(folder), compile=True, run=True, with_output=False)
    spikes, weight = described.fired(), np.array(described.plastic.w)
    results = brian2.device.results_dir

    def run() -> Run:
        subprocess.run(["./main", "--results_dir", results], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        return Run(float((Path(results) / "last_run_info.txt").read_text().split()[0]), spikes, weight)

    return run


def runtime(network: Network, injected: Tensor, target: str) -> Callable[[], Run]:
    """The network in Brian2's runtime mode, with the code generation of that name (cython or numpy)."""
    brian2.set_device("runtime")
    brian2.prefs.codegen.target = target

    def run() -> Run:
        described = describe(network, injected)
        described.simulation.run(0 * brian2.ms)
        began = time.perf_counter()
        described.simulation.run(len(injected) * brian2.ms)
        return Run(time.perf_counter() - began, described.fired(), np.array(described.plastic.w))

    return run
