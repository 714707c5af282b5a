"""The same network in ANNarchy, as near as its clock allows, and without homeostasis, which it has no equations for.

All trials of a batch are neurons of one population. ANNarchy handles a spike when it arrives, one ms after it was
fired: traces are set and lowered by as much as they have faded in that ms, and what a presynaptic spike takes from the
eligibility, and a postsynaptic one adds to it, counts for the weight one ms later than it does here.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import ANNarchy
import numpy as np
import scipy.sparse
import torch
from recording import Run
from torch import Tensor

from snnrl.model.network import Network

NEURON = """
level = baseline + (level - baseline) * fading + release * ite(g_count > threshold, g_count, 0.0)
inflow = g_exc + g_given
half = v + 0.5 * (0.04 * v * v + 5.0 * v + 140.0 - u + inflow)
v = half + 0.5 * (0.04 * half * half + 5.0 * half + 140.0 - u + inflow)
u = u + a * (b * v - u)
"""
PLASTIC = """
dgain/dt = -gain / tau_plus : event-driven
dloss/dt = -loss / tau_minus : event-driven
eligibility = eligibility * fading
w = clip(w + eligibility * post.level, 0.0, weight_max)
"""
ARRIVES = "g_target += synaptic_gain * w"
PAIRS = """
eligibility -= later * loss
gain = potentiation
"""


def openmp(network: Network, injected: Tensor, threads: int, folder: Path) -> Callable[[], Run]:
    """The network compiled with OpenMP, in its present state (at ms 0), driven by `injected` [T, B, N]; each call runs
    it from the start.
    """
    described = ANNarchy.Network(dt=1.0)
    described.config(num_threads=threads)
    neurons = described.create(network.trials * network.size, neuron_of(network))
    start = {key: getattr(network.neurons, key).flatten().numpy() for key in ("v", "u", "a", "b", "c", "d")}
    current = (network.background(torch.arange(len(injected))) + injected).flatten(1).numpy()
    given = described.create(ANNarchy.TimedArray(rates=current[1:]))  # a current reaches neurons one ms later
    described.connect(ANNarchy.CurrentInjection(given, neurons, "given")).connect_current()
    plastic, fixed = network.synapses.plastic, len(network.synapses.weight)
    projection = described.connect(neurons, neurons, "exc", plastic_of(network))
    projection.from_sparse(matrix_of(network, slice(plastic)), delays=1.0)
    if fixed > plastic:
        still = ANNarchy.Synapse(parameters=f"synaptic_gain = {network.synaptic_gain} : projection", pre_spike=ARRIVES)
        described.connect(neurons, neurons, "exc", still).from_sparse(
            matrix_of(network, slice(plastic, fixed)), delays=1.0
        )
    dopamine = network.dopamine
    assert dopamine is not None
    described.connect(neurons, neurons, "count").from_sparse(releases_of(network), delays=float(dopamine.delay))
    spikes = described.monitor(neurons, "spike")
    described.compile(directory=str(folder), silent=True)

    def run() -> Run:
        described.reset(projections=True, synapses=True)
        for key, values in start.items():
            setattr(neurons, key, values)
        given.r = current[0]
        neurons.level = np.repeat(dopamine.level.numpy(), network.size)
        began = time.perf_counter()
        described.simulate(float(len(injected)))
        wall = time.perf_counter() - began
        times, ranks = spikes.raster_plot(spikes.get("spike"))
        fired = np.stack([np.round(times).astype(int), ranks], 1)
        return Run(wall, fired[np.lexsort((fired[:, 1], fired[:, 0]))], weights_of(projection, network))

    return run


def neuron_of(network: Network) -> ANNarchy.Neuron:
    dopamine = network.dopamine
    assert dopamine is not None
    shared = {
        "baseline": dopamine.baseline,
        "fading": float(np.exp(-1.0 / dopamine.tau)),
        "release": dopamine.values["release"],
        "threshold": dopamine.values["threshold"],
    }
    own = "".join(f"{key} = 0.0\n" for key in "abcd")
    return ANNarchy.Neuron(
        parameters=own + "".join(f"{key} = {value!r} : population\n" for key, value in shared.items()),
        equations=NEURON,
        spike="v >= 30.0",
        reset="v = c\nu += d",
    )


def plastic_of(network: Network) -> ANNarchy.Synapse:
    rule = network.learning()[0].rule
    shared = {
        "tau_plus": rule.tau_plus,
        "tau_minus": rule.tau_minus,
        "fading": float(np.exp(-1.0 / rule.tau_eligibility)),
        "weight_max": rule.weight_max,
        "synaptic_gain": network.synaptic_gain,
        "potentiation": rule.potentiation * float(np.exp(-1.0 / rule.tau_plus)),
        "depression": rule.depression,
        "later": float(np.exp(1.0 / rule.tau_minus)),
    }
    return ANNarchy.Synapse(
        parameters="".join(f"{key} = {value!r} : projection\n" for key, value in shared.items()),
        equations=PLASTIC,
        pre_spike=ARRIVES + PAIRS,
        post_spike="eligibility += gain\nloss = depression",
    )


def matrix_of(network: Network, chosen: slice) -> scipy.sparse.csc_array:
    """Weights of some synapses, from presynaptic to postsynaptic neuron of all trials."""
    table, size = network.synapses, network.trials * network.size
    assert bool((table.delay[chosen] == 1).all())
    pre, post, weight = (part[chosen].numpy() for part in (table.pre, table.post, table.weight))
    return scipy.sparse.csc_matrix((weight, (pre, post)), shape=(size, size))


def releases_of(network: Network) -> scipy.sparse.csc_array:
    """From each dopaminergic neuron to all neurons of its trial."""
    dopamine = network.dopamine
    assert dopamine is not None
    source = network.groups[dopamine.sources["count"]].span
    one = np.zeros((network.size, network.size))
    one[source] = 1.0
    return scipy.sparse.csc_matrix(scipy.sparse.kron(scipy.sparse.eye(network.trials), one))


def weights_of(projection: ANNarchy.Projection, network: Network) -> np.ndarray:
    """Of the plastic synapses [S], in the network's order: ANNarchy has them by postsynaptic neuron."""
    table, found = network.synapses, np.empty(network.synapses.plastic)
    pre, post = (part[: table.plastic].numpy() for part in (table.pre, table.post))
    found[np.lexsort((pre, post))] = np.concatenate([np.asarray(weights) for weights in projection.w])
    return found
