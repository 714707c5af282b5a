"""A network as tables of numbers that engines compiled for a processor work through; they know no name.

Neurons are laid out anew: each part of the network (neighbouring groups of one model) begins at a multiple of LANES,
so that no vector holds neurons of two models. A neuron's `place` is where it then stands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from snnrl.model.draws import stream
from snnrl.model.modulators import burst
from snnrl.model.network import Network
from snnrl.model.neurons import NeuronModel
from snnrl.model.plasticity import Plasticity, hard_bounds
from snnrl.model.synapses import Projection

DENSE = 0.25  # part of the pairs from which on a projection is stored as rows of all its pairs
LARGEST = 1 << 18  # bytes of a trial's rows of one projection
MILLISECONDS = 100  # most between two points at which all tensors are up to date

# columns of Tables.groups
SIZE, START, PLACE = range(3)
# columns of Tables.noises
NOISE_PLACE, NOISE_SIZE, NOISE_STREAM = range(3)
# columns of Tables.projections
PRE, POST, DELAY, SET, RULE, SIGNAL, ROWS, COLUMNS, ROW_AT, MASK_AT = range(10)
# columns of Tables.rules
GAINS, GAINS_END, LOSSES, LOSSES_END, DEPRESSES, WEIGHT_RULE, BOUNDS, ADDS_UP = range(8)
# columns of Tables.modulators and of Tables.modulator_values
DELAYED, SIGNED, SMOOTHED, RELEASED, SOURCES, SOURCES_END, FURTHER = range(7)
BASELINE, DECAY, FADING, REWARD = range(4)
NONE = -1
USUAL = ((hard_bounds, 2),), ((burst, 1, 2),)


class Tables(NamedTuple):
    """A network as numbers; real ones are of its precision. G groups, P projections, K sets, M modulators."""

    lanes: Any
    places: Any  # how many, a multiple of the lanes
    groups: Any  # int64 [G, 3]
    group_of: Any  # int64 [places]
    neuron_of: Any  # int64 [places], NONE where there is no neuron
    model_of: Any  # int64 [places / lanes], place of the model that a block's neurons have
    valid: Any  # int64 [places / lanes], a bit for each lane with a neuron
    restless: Any  # bool [places / lanes], whether its background changes from ms to ms
    background: Any  # real [places], constant currents
    noises: Any  # int64 [Q, 3], of groups with a noisy background
    noise_values: Any  # real [Q, 2], current and amplitude
    projections: Any  # int64 [P, 10]
    source: Any  # int32 [S], a synapse's presynaptic place
    target: Any  # int32 [S], its postsynaptic place
    rows: Any  # int64, offsets of each presynaptic neuron's synapses, by projection, trial and neuron
    columns: Any  # int64, offsets into `incoming` of each postsynaptic neuron's synapses, of those that learn
    incoming: Any  # int32, synapses ordered by postsynaptic neuron
    dense: Any  # how many reals a trial's dense rows take
    masks: Any  # how many blocks of LANES pairs those are
    rules: Any  # int64 [R, 8]
    windows: Any  # real, the windows of all rules end to end
    bounds: Any  # real, the further arguments of all weight rules
    least: Any  # real [P], the least weight of each projection
    most: Any  # real [P], the weight above which it cannot rise
    fading: Any  # real [R, MILLISECONDS + 1], decay^k
    signals: Any  # real [Sg, M], factor of each modulator in what synapses of one rule listen to
    signal_rule: Any  # int64 [Sg]
    headroom: Any  # real, the most that a spike can add to all eligibilities
    set_limit: Any  # float64 [B, K]
    set_step: Any  # real [K]
    set_always: Any  # bool [K], whether its mean may rise in a way that no sum foretells
    modulators: Any  # int64 [M, 7]
    modulator_values: Any  # real [M, 4]
    sources: Any  # int64, groups
    further: Any  # real, the further arguments of all functions of release
    gain: Any  # real, current per mV
    trials: Any  # int64 [B], their numbers
    seed: Any


@dataclass(frozen=True)
class Functions:
    """What the tables' numbers of models, weight rules and releases stand for, and the columns of the models."""

    models: tuple[NeuronModel, ...]
    columns: tuple[str, ...]
    weight_rules: tuple[tuple[Callable[..., Any], int], ...]  # with the number of further arguments
    releases: tuple[tuple[Callable[..., Any], int, int], ...]  # with the numbers of sources and further arguments


@dataclass(frozen=True)
class Topology:
    """What does not change as long as a network has the same synapses."""

    places: dict[str, Any]
    synapses: dict[str, Any]
    described: np.ndarray  # int64 [P, 10], without rules, signals and sets
    settled: np.ndarray  # real [S], zeros for engines to work with


def topology(network: Network, lanes: int) -> Topology:
    """Where neurons and synapses stand."""
    places = _places(network, lanes)
    settled = np.zeros(network.synapses.plastic, network.pending.numpy().dtype)
    return Topology(places, *_synapses(network, places["groups"], lanes), settled)


def tables(network: Network, known: Topology, lanes: int) -> tuple[Tables, Functions]:
    """The tables of a network as it is now; what `topology` gave is not made anew."""
    real = network.pending.numpy().dtype
    rules, signals, described = _learning(network, known.described)
    largest = max((float(w.abs().max()) for rule in rules for w in (rule.gains, rule.losses)), default=0.0)
    fans = [max(p.shape[1:]) for p in network.projections.values() if p.plastic]
    weight_rules = tuple(dict.fromkeys((rule.weight_rule, len(rule.bounds)) for rule in rules))
    releases = tuple(
        dict.fromkeys((m.released, len(m.sources), len(m.further)) for m in network.modulators.values() if m.sources)
    )
    names = list(network.modulators)
    sets = list(network.homeostasis.values())
    values = {
        "projections": described,
        "least": np.array([p.rule.weight_min if p.rule else 0.0 for p in network.projections.values()], real),
        "most": np.array([_most(p) for p in network.projections.values()], real),
        **_rules(rules, weight_rules, real),
        "signals": np.array([[listens.get(name, 0.0) for name in names] for _, listens in signals], real).reshape(
            len(signals), len(names)
        ),
        "signal_rule": np.array([rule for rule, _ in signals], np.int64),
        "headroom": real.type(2 * largest * sum(fans)),
        "set_limit": np.stack([(s.limit * network.set_size(s)).numpy() for s in sets], 1)
        if sets
        else np.zeros((network.trials, 0)),
        "set_step": np.array([s.step for s in sets], real),
        "set_always": np.array([not all(_foretold(network, name) for name in s.projections) for s in sets], bool),
        **_modulators(network, releases, real),
        "gain": real.type(network.synaptic_gain),
        "trials": network.draws.trials.numpy(),
        "seed": network.draws.seed,
        **_background(network, known.places, lanes, real),
    }
    models = tuple(dict.fromkeys(model for model, _ in network.neurons.parts))
    # what no synapse or modulator needs is as in most networks, so that fewer variants are compiled
    functions = Functions(models, tuple(network.neurons.columns), weight_rules or USUAL[0], releases or USUAL[1])
    return Tables(lanes=lanes, **known.places, **known.synapses, **values), functions


def _places(network: Network, lanes: int) -> dict[str, Any]:
    groups, at = [], 0
    parts = {part[1].start: part for part in network.neurons.parts}
    models = list(dict.fromkeys(model for model, _ in network.neurons.parts))
    model_of: list[int] = []
    for group in network.groups.values():
        if group.start in parts:
            at = -(-at // lanes) * lanes
            model, span = parts[group.start]
            model_of += [models.index(model)] * -(-(span.stop - span.start) // lanes)
        groups.append((group.size, group.start, at))
        at += group.size
    count = -(-at // lanes) * lanes
    group_of, neuron_of = np.zeros(count, np.int64), np.full(count, NONE, np.int64)
    for k, (size, start, place) in enumerate(groups):
        group_of[place : place + size], neuron_of[place : place + size] = k, np.arange(start, start + size)
    bits = (neuron_of != NONE).reshape(-1, lanes) @ (1 << np.arange(lanes, dtype=np.int64))
    return {
        "places": count,
        "groups": np.array(groups, np.int64),
        "group_of": group_of,
        "neuron_of": neuron_of,
        "model_of": np.array(model_of, np.int64),
        "valid": bits,
    }


def _synapses(network: Network, groups: np.ndarray, lanes: int) -> tuple[dict[str, Any], np.ndarray]:
    place = {name: k for k, name in enumerate(network.groups)}
    shift = np.concatenate([np.full(size, at - start) for size, start, at in groups])
    rows, columns, incoming, described = [], [], [], []
    row, column, synapse, entry, dense, masks = 0, 0, 0, 0, 0, 0
    for projection in network.projections.values():
        trials, pre_size, post_size = projection.shape
        source = (projection.trial * pre_size + projection.pre_index).numpy()
        rows.append(synapse + np.searchsorted(source, np.arange(trials * pre_size)))
        column_at, row_at, mask_at = NONE, NONE, NONE
        blocks = pre_size * -(-post_size // lanes)
        if _is_dense(projection, blocks * lanes):
            row_at, dense = dense, dense + blocks * lanes * (3 if projection.plastic else 1)
            if projection.plastic:
                mask_at, masks = masks, masks + blocks
        elif projection.plastic:
            target = (projection.trial * post_size + projection.post_index).numpy()
            order = np.argsort(target, kind="stable")
            columns.append(entry + np.searchsorted(target[order], np.arange(trials * post_size)))
            incoming.append(synapse + order)
            column_at, column, entry = column, column + trials * post_size, entry + len(order)
        ends = place[projection.pre], place[projection.post]
        described.append((*ends, projection.delay, NONE, NONE, NONE, row, column_at, row_at, mask_at))
        row, synapse = row + trials * pre_size, synapse + len(source)
    neurons = [(ends % network.size).numpy() for ends in (network.synapses.pre, network.synapses.post)]
    found = {
        "source": (neurons[0] + shift[neurons[0]]).astype(np.int32),
        "target": (neurons[1] + shift[neurons[1]]).astype(np.int32),
        "rows": _joined([*rows, [synapse]], np.int64),
        "columns": _joined([*columns, [entry]], np.int64),
        "incoming": _joined(incoming, np.int32),
        "dense": dense,
        "masks": masks,
    }
    return found, np.array(described, np.int64).reshape(-1, 10)


def _is_dense(projection: Projection, entries: int) -> bool:
    trials, pre_size, post_size = projection.shape
    filled = len(projection.weight) / (trials * pre_size * post_size)
    return filled >= DENSE and 3 * entries * projection.weight.element_size() <= LARGEST


def _learning(
    network: Network, described: np.ndarray
) -> tuple[list[Plasticity], list[tuple[int, dict[str, float]]], np.ndarray]:
    """The rules, what synapses listen to by rule, and the projections with the numbers of both and of their sets."""
    described = described.copy()
    rules: list[Plasticity] = []
    signals: list[tuple[int, dict[str, float]]] = []
    for part in network.learning():
        if part.rule not in rules:
            rules.append(part.rule)
        signal = rules.index(part.rule), dict(part.listens)
        if signal not in signals:
            signals.append(signal)
        for k, name in enumerate(network.projections):
            if name in part.projections:
                described[k, RULE], described[k, SIGNAL] = signal[0], signals.index(signal)
    names = list(network.projections)
    for number, homeostasis in enumerate(network.homeostasis.values()):
        for name in homeostasis.projections:
            described[names.index(name), SET] = number
    return rules, signals, described


def _most(projection: Projection) -> float:
    return projection.rule.weight_max if projection.rule and projection.rule.adds_up else math.inf


def _foretold(network: Network, name: str) -> bool:
    rule = network.projections[name].rule
    return rule is None or rule.adds_up


def _rules(rules: list[Plasticity], weight_rules: tuple[Any, ...], real: Any) -> dict[str, Any]:
    described, windows, at = [], [], 0
    bounds: list[float] = []
    for rule in rules:
        ends = at, at + len(rule.gains), at + len(rule.gains) + len(rule.losses)
        depresses = rule.simultaneous == "depresses"
        weight_rule = weight_rules.index((rule.weight_rule, len(rule.bounds)))
        described.append((*ends[:2], *ends[1:], depresses, weight_rule, len(bounds), rule.adds_up))
        windows += [rule.gains.numpy(), rule.losses.numpy()]
        bounds += rule.bounds
        at = ends[2]
    powers = [np.cumprod([1.0, *[rule.decay] * MILLISECONDS]) for rule in rules]
    return {
        "rules": np.array(described, np.int64).reshape(-1, 8),
        "windows": _joined(windows, real),
        "bounds": np.array(bounds, real),
        "fading": np.array(powers, real).reshape(-1, MILLISECONDS + 1),
    }


def _modulators(network: Network, releases: tuple[Any, ...], real: Any) -> dict[str, Any]:
    place = {name: k for k, name in enumerate(network.groups)}
    described, values = [], []
    sources: list[int] = []
    further: list[float] = []
    for m in network.modulators.values():
        released = releases.index((m.released, len(m.sources), len(m.further))) if m.sources else NONE
        ends = len(sources), len(sources) + len(m.sources)
        described.append((m.delay, m.signed, m.smoothing > 0, released, *ends, len(further)))
        values.append((m.baseline, m.decay, m.fading, m.reward))
        sources += [place[name] for name in m.sources.values()]
        further += m.further if m.sources else ()
    return {
        "modulators": np.array(described, np.int64).reshape(-1, 7),
        "modulator_values": np.array(values, real).reshape(-1, 4),
        "sources": np.array(sources, np.int64),
        "further": np.array(further, real),
    }


def _background(network: Network, places: dict[str, Any], lanes: int, real: Any) -> dict[str, Any]:
    constant = np.zeros(places["places"], real)
    restless = np.zeros(places["places"] // lanes, bool)
    noises, values = [], []
    for group, (size, _, at) in zip(network.groups.values(), places["groups"].tolist(), strict=True):
        constant[at : at + size] = group.current
        if group.noise:
            noises.append((at, size, stream("background", group.name)))
            values.append((group.current, group.noise))
            restless[at // lanes : (at + size - 1) // lanes + 1] = True
    return {
        "background": constant,
        "restless": restless,
        "noises": np.array(noises, np.int64).reshape(-1, 3),
        "noise_values": np.array(values, real).reshape(-1, 2),
    }


def _joined(parts: list[Any], dtype: Any) -> Any:
    return np.concatenate([np.zeros(0, dtype), *parts]).astype(dtype)
