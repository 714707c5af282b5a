"""Both engines against NEST's stdp_dopamine_synapse, as far as the two rules agree (docs/conformance.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.util import find_spec

import pytest
import torch
from helpers import ENGINES, RULE, forced, make_dopamine, make_group, make_network, make_projection, run, spikes_of

if find_spec("nest") is None:
    pytest.skip("NEST is not installed: pip install 'snnrl[peers]'", allow_module_level=True)
import nest

END = 900  # ms
START, TAU_DOPAMINE, DELAY = 2.0, 25.0, 5
TRAINS = {
    "one pre before many post": ([50], [53, 70, 95, 180]),
    "one post before many pre": ([61, 85, 130, 300], [50]),
    "one pair either way": ([50], [52]),
}
RELEASED = [60, 61, 150, 155, 400]  # when dopamine rises, ms


def peer(pre: Sequence[int], post: Sequence[int], baseline: float) -> dict[str, float]:
    """State of NEST's synapse after `END` ms; spike times are those at which they reach the synapse."""
    nest.ResetKernel()
    nest.resolution = 1.0
    # a generator's spike is relayed 1 ms later, and reaches the synapse from the postsynaptic side and
    # the volume transmitter another ms later
    trains = [[time - 1.0 for time in pre], [time - 2.0 for time in post], [time - 2.0 for time in RELEASED]]
    sources = nest.Create("spike_generator", 3, [{"spike_times": times} for times in trains])
    relays = nest.Create("parrot_neuron", 3, {"tau_minus": RULE.tau_minus})
    transmitter = nest.Create("volume_transmitter")
    nest.Connect(sources, relays, "one_to_one", {"delay": 1.0})
    nest.Connect(relays[2], transmitter, syn_spec={"delay": 1.0})
    rule = {
        "volume_transmitter": transmitter,
        "A_plus": RULE.potentiation,
        "A_minus": RULE.depression,
        "tau_plus": RULE.tau_plus,
        "tau_c": RULE.tau_eligibility,
        "tau_n": TAU_DOPAMINE,
        "b": -baseline,
        "Wmin": 0.0,
        "Wmax": RULE.weight_max,
    }
    nest.CopyModel("stdp_dopamine_synapse", "plastic", rule)
    synapse = {"synapse_model": "plastic", "weight": START, "delay": 1.0, "receptor_type": 1}
    nest.Connect(relays[0], relays[1], syn_spec=synapse)
    nest.Simulate(float(END))
    state: dict[str, float] = nest.GetConnections(relays[0], relays[1]).get(["weight", "c", "n"])
    return state


def share(rate: float) -> float:
    """Sum over whole ms of exp(-rate t), over its integral."""
    return rate / -math.expm1(-rate)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("baseline", [-0.004, 0.002])
@pytest.mark.parametrize(("pre", "post"), TRAINS.values(), ids=TRAINS)
def test_engines_agree_with_nest(engine: str, baseline: float, pre: list[int], post: list[int]) -> None:
    network = make_network(
        [make_group(name, 1) for name in ("pre", "post", "dopaminergic")],
        [make_projection("plastic", "pre", "post", torch.full((1, 1, 1), START, dtype=torch.float64))],
        make_dopamine(baseline=baseline, tau=TAU_DOPAMINE, release=1.0 / TAU_DOPAMINE, delay=DELAY, threshold=0),
        gain=0.0,
    )
    released = [time - DELAY for time in RELEASED]
    spikes = {("pre", 0): pre, ("post", 0): post, ("dopaminergic", 0): released}
    injected = forced(network, END + 1, spikes)
    raster = run(engine, network, injected[:END])
    assert [spikes_of(raster, k) for k in range(3)] == [pre, post, released]
    weight = float(network.synapses.weight)  # with the steps up to END - 1, which stand for the time up to END
    run(engine, network, injected[END:])

    quiet, expected = peer(pre, post, 0.0), peer(pre, post, baseline)
    phasic, tonic = quiet["weight"] - START, expected["weight"] - quiet["weight"]
    assert abs(phasic) > 1e-3
    assert network.dopamine is not None
    assert float(network.dopamine.level) - baseline == pytest.approx(expected["n"], rel=1e-9)
    assert float(network.synapses.eligibility) == pytest.approx(expected["c"], rel=1e-9)
    rate = 1.0 / RULE.tau_eligibility
    change = phasic * share(rate + 1.0 / TAU_DOPAMINE) + tonic * share(rate)
    assert weight - START == pytest.approx(change, rel=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_neuron_fires_when_it_does_in_nest(engine: str) -> None:
    nest.ResetKernel()
    nest.resolution = 1.0
    model = {"a": 0.02, "b": 0.2, "c": -65.0, "d": 8.0, "I_e": 10.0, "consistent_integration": False}
    neuron, recorder = nest.Create("izhikevich", 1, model), nest.Create("spike_recorder")
    nest.Connect(neuron, recorder)
    nest.Simulate(float(END))
    network = make_network([make_group("driven", 1)])
    spikes = spikes_of(run(engine, network, torch.full((END, 1, 1), 10.0, dtype=torch.float64)), 0)
    assert len(spikes) > 10
    assert [time - 1.0 for time in recorder.get("events")["times"]] == spikes  # NEST gives the ends of steps
