"""The same network in Brian2, made from a network's own tables; the mapping is in docs/conformance.md."""

from __future__ import annotations

import gc
import logging
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from snnrl.homeostasis import Homeostasis
from snnrl.network import Network

if "ptp" not in vars(np.ndarray):
    # Brian2 2.9, the last for Python 3.11, looks at import for a method that NumPy 2.4 has dropped
    gc.get_referents(vars(np.ndarray))[0]["ptp"] = np.ptp
import brian2

brian2.prefs.codegen.target = "numpy"
brian2.prefs.codegen.loop_invariant_optimisations = False  # which reorders sums, and so rounds differently
brian2.defaultclock.dt = 1 * brian2.ms
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
# v is reset only after the synapses' turn, so v < 30 says that a neuron has not fired in this step
PLASTIC = """
w : 1
sent : 1
deligibility/dt = -eligibility / tau_eligibility : 1 (clock-driven)
dgain/dt = -gain / tau_plus : 1 (event-driven)
dloss/dt = -loss / tau_minus : 1 (event-driven)
"""
ARRIVE, LEVEL, SHARE, PAIR, WEIGHT, HOMEOSTASIS, LATCH, SEND = range(8)


@dataclass
class Course:
    """What one trial did: spikes [n, 2] (ms, neuron), and the values after every `every` ms, [T / every, ...]."""

    spikes: np.ndarray
    eligibility: np.ndarray
    weight: np.ndarray
    level: np.ndarray


def simulate(network: Network, injected: Tensor, every: int = 1) -> Course:
    """The network's only trial through all rows of `injected` [T, 1, N], from its present state (at ms 0)."""
    table, dopamine, rule = network.synapses, network.dopamine, network.plasticity
    assert network.trials == 1
    assert int(network.time) == 0
    assert dopamine is not None
    ms = brian2.ms
    background = network.background(torch.arange(len(injected)))
    values = {
        "background": brian2.TimedArray(background[:, 0].numpy(), dt=ms),
        "injected": brian2.TimedArray(injected[:, 0].numpy(), dt=ms),
        "baseline": dopamine.baseline,
        "release": dopamine.release,
        "tau": dopamine.tau * ms,
        "threshold": dopamine.threshold,
        "tau_eligibility": rule.tau_eligibility * ms,
        "tau_plus": rule.tau_plus * ms,
        "tau_minus": rule.tau_minus * ms,
        "potentiation": rule.potentiation,
        "depression": rule.depression,
        "weight_max": rule.weight_max,
        "synaptic_gain": network.synaptic_gain,
    }
    neurons = brian2.NeuronGroup(
        network.size, NEURON, threshold="v >= 30", reset="v = c; u += d", method="exact", namespace=values
    )
    for key in ("v", "u", "a", "b", "c", "d"):
        setattr(neurons, key, getattr(network.neurons, key)[0].numpy())
    neurons.run_regularly(MEMBRANE, when="groups")
    modulator = brian2.NeuronGroup(1, MODULATOR, method="exact", namespace=values)
    modulator.level = float(dopamine.level[0])
    modulator.run_regularly(
        "level += release * arrived * int(arrived > threshold); arrived = 0", when="synapses", order=LEVEL
    )
    neurons.modulator_level = brian2.linked_var(modulator, "level", index=np.zeros(network.size, int))
    neurons.run_regularly("level = modulator_level", when="synapses", order=SHARE)
    assert dopamine.source is not None
    source = network.groups[dopamine.source].span
    release = brian2.Synapses(neurons, modulator, on_pre="arrived_post += 1", delay=dopamine.delay * ms)
    release.connect(i=np.arange(source.start, source.stop), j=0)
    release.pre.order = ARRIVE
    members = [neurons, modulator, release]

    count = table.plastic
    pre, post, delay = (part.numpy() for part in (table.pre, table.post, table.delay))
    plastic = brian2.Synapses(
        neurons,
        neurons,
        PLASTIC,
        on_pre={
            "pair": "eligibility -= loss * int(v_post < 30); gain = potentiation",
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
    # Brian2 runs the postsynaptic pathway after those of the same order that were made before it
    plastic.pair.order, plastic.post.order, plastic.latch.order, plastic.send.order = PAIR, PAIR, LATCH, SEND
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
    for homeostasis in network.homeostasis.values():
        members.append(_dampening(network, homeostasis, plastic))

    spikes = brian2.SpikeMonitor(neurons)
    clock = brian2.Clock(dt=every * ms)
    synapses = brian2.StateMonitor(plastic, ["eligibility", "w"], record=True, clock=clock, when="start")
    level = brian2.StateMonitor(modulator, "level", record=0, clock=clock, when="start")
    simulation = brian2.Network(*members, spikes, synapses, level)
    simulation.run((len(injected) + 1) * ms)  # one step more, whose start is the last one's end
    fired = np.stack([np.round(spikes.t / ms).astype(int), np.array(spikes.i)], 1)
    fired = fired[np.lexsort((fired[:, 1], fired[:, 0]))]
    return Course(
        fired[fired[:, 0] < len(injected)], synapses.eligibility.T[1:], synapses.w.T[1:], level.level[0][1:, None]
    )


def _dampening(network: Network, homeostasis: Homeostasis, plastic: brian2.Synapses) -> brian2.NetworkOperation:
    parts, start = [], 0
    pairs = 0
    for projection in network.projections.values():
        stop = start + len(projection.weight)
        if projection.name in homeostasis.projections:
            parts.append(np.arange(start, stop))
            pairs += projection.shape[1] * projection.shape[2]
        start = stop
    chosen = np.concatenate(parts)
    over = pairs if homeostasis.count_absent else len(chosen)

    @brian2.network_operation(when="synapses", order=HOMEOSTASIS)
    def dampen() -> None:
        weight = plastic.w[chosen]
        if weight.sum() / over > homeostasis.limit:
            plastic.w[chosen] = np.maximum(weight - homeostasis.step, 0.0)

    return dampen
