"""NEST with its own dopamine-modulated STDP: the same neurons, synapses and currents, learning by another rule.

`stdp_dopamine_synapse` pairs a spike with all earlier ones, counts every dopaminergic spike and has no homeostasis. Its
weights are here in the unit of the current that they send, and each trial has a volume transmitter of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import nest
import numpy as np
import torch
from recording import Run
from torch import Tensor

from snnrl.model.network import Network

LATE = 2  # ms until the first current reaches a neuron


def kernel(network: Network, injected: Tensor, threads: int) -> Callable[[], Run]:
    """The network in its present state (at ms 0), driven by `injected` [T, B, N]; each call builds and runs it.

    A process has one number of threads: NEST has crashed where it was raised after a run.
    """
    return lambda: simulate(network, injected, threads)


def simulate(network: Network, injected: Tensor, threads: int) -> Run:
    nest.ResetKernel()
    nest.verbosity = nest.VerbosityLevel.ERROR
    nest.set(resolution=1.0, local_num_threads=threads)
    neurons = driven(network, injected)
    connect(network, neurons)
    recorder = nest.Create("spike_recorder")
    nest.Connect(neurons, recorder)
    nest.Prepare()
    began = time.perf_counter()
    nest.Run(float(len(injected) + LATE))
    wall = time.perf_counter() - began
    nest.Cleanup()
    events = recorder.get("events")
    times = np.round(events["times"]).astype(int) - 1 - LATE  # NEST gives the ends of steps
    fired = np.stack([times, np.asarray(events["senders"]) - neurons[0].global_id], 1)
    return Run(wall, fired[np.lexsort((fired[:, 1], fired[:, 0]))], weights_of(network, neurons))


def driven(network: Network, injected: Tensor) -> nest.NodeCollection:
    """All neurons of all trials, each with the currents that it gets."""
    state = {key: getattr(network.neurons, key).flatten().numpy() for key in ("v", "u", "a", "b", "c", "d")}
    named = {"V_m" if key == "v" else "U_m" if key == "u" else key: values for key, values in state.items()}
    each = [dict(zip(named, map(float, values), strict=True)) for values in zip(*named.values(), strict=True)]
    neurons = nest.Create("izhikevich", len(each), {"consistent_integration": False, "V_th": 30.0})
    neurons.set(each)
    current = (network.background(torch.arange(len(injected))) + injected).flatten(1).numpy()
    times = np.arange(1.0, len(current) + 1.0)
    steps = [{"amplitude_times": times, "amplitude_values": np.ascontiguousarray(course)} for course in current.T]
    generators = nest.Create("step_current_generator", len(steps), steps)
    nest.Connect(generators, neurons, "one_to_one", {"delay": 1.0})
    return neurons


def connect(network: Network, neurons: nest.NodeCollection) -> None:
    """Plastic synapses, a model for each trial, as its transmitter is the model's, and fixed ones."""
    dopamine, rule, table, gain = network.dopamine, network.learning()[0].rule, network.synapses, network.synaptic_gain
    assert dopamine is not None
    released = dopamine.values["release"] * dopamine.tau  # of the unit of NEST's, of which a spike releases 1 / tau
    source = network.groups[dopamine.sources["count"]].span
    first = neurons[0].global_id
    pre, post = table.pre.numpy() + first, table.post.numpy() + first
    weight, trial = gain * table.weight.numpy(), table.trial.numpy()
    learns = np.arange(len(weight)) < table.plastic
    for k in range(network.trials):
        transmitter = nest.Create("volume_transmitter")
        start = k * network.size
        dopaminergic = neurons[start + source.start : start + source.stop]
        nest.Connect(dopaminergic, transmitter, syn_spec={"delay": float(dopamine.delay)})
        described = {
            "volume_transmitter": transmitter,
            "A_plus": gain * released * rule.potentiation,
            "A_minus": gain * released * rule.depression,
            "tau_plus": rule.tau_plus,
            "tau_c": rule.tau_eligibility,
            "tau_n": dopamine.tau,
            "b": -dopamine.baseline / released,
            "Wmin": 0.0,
            "Wmax": gain * rule.weight_max,
        }
        nest.CopyModel("stdp_dopamine_synapse", f"plastic_{k}", described)
        chosen = learns & (trial == k)
        synapses = {"synapse_model": f"plastic_{k}", "weight": weight[chosen], "delay": np.ones(chosen.sum())}
        nest.Connect(pre[chosen], post[chosen], "one_to_one", synapses)
    if not learns.all():
        synapses = {"weight": weight[~learns], "delay": np.ones((~learns).sum())}
        nest.Connect(pre[~learns], post[~learns], "one_to_one", synapses)


def weights_of(network: Network, neurons: nest.NodeCollection) -> np.ndarray:
    """Of the plastic synapses [S], in the network's order."""
    table, found = network.synapses, np.empty(network.synapses.plastic)
    pre, post = (part[: table.plastic].numpy() for part in (table.pre, table.post))
    held = [
        nest.GetConnections(synapse_model=f"plastic_{k}").get(["source", "target", "weight"], output="pandas")
        for k in range(network.trials)
    ]
    columns = {key: np.concatenate([one[key].to_numpy() for one in held]) for key in ("source", "target", "weight")}
    order = np.lexsort((columns["source"], columns["target"]))
    found[np.lexsort((pre, post))] = columns["weight"][order] / network.synaptic_gain
    return found
