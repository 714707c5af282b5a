"""A network as tables of numbers that engines compiled for a processor work through; they know no name.

Neurons are laid out anew: each part of the network (neighbouring groups of one model) begins at a multiple of LANES,
so that no vector holds neurons of two models. A neuron's `place` is where it then stands.

Projections with many of the pairs that they could have are kept dense: those that learn, of one rule and set and onto
one group, as one matrix of tiles (`snnrl.engines.fused.tiles`), others as rows. The rest are lists.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch

from snnrl.model.draws import stream
from snnrl.model.modulators import burst
from snnrl.model.network import Network
from snnrl.model.neurons import NeuronModel
from snnrl.model.plasticity import Plasticity, hard_bounds
from snnrl.model.synapses import Projection

DENSE = 0.25  # part of the pairs from which on a projection is kept dense
LARGEST = 1 << 18  # bytes that one may then take in a trial
MILLISECONDS = 100  # most between two points at which all tensors are up to date
DECAYS = 60.0  # time constants of an eligibility between these, at most: e^60 is far from the largest float32

# columns of Tables.groups
SIZE, START, PLACE = range(3)
# columns of Tables.noises
NOISE_AT, NOISE_SIZE, NOISE_STREAM, NOISE_GROUP = range(4)
# columns of Tables.projections
PRE, POST, DELAY, SET, RULE, SIGNAL, ROWS, COLUMNS, DENSE_AT = range(9)
# columns of Tables.matrices and of Tables.members
ONTO, BY_RULE, LISTENS, OF_SET, TILE, WIDTH, RISE, ROW, MEMBERS, MEMBERS_END = range(10)
FROM, OFFSET, MEMBER = range(3)
# columns of Tables.rules
GAINS, GAINS_END, LOSSES, LOSSES_END, DEPRESSES, WEIGHT_RULE, BOUNDS, ADDS_UP = range(8)
# columns of Tables.modulators and of Tables.modulator_values
DELAYED, SIGNED, SMOOTHED, RELEASED, SOURCES, SOURCES_END, FURTHER, RING = range(8)
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
    background: Any  # real [places], constant currents
    background_at: Any  # int64 [places / lanes], where a block's background is: among the constant ones, or behind
    background_step: Any  # int64 [places / lanes], how far from there to that of the next ms; 0 of a constant one
    noises: Any  # int64 [Q, 4], of groups with a noisy background; one of these may be in it several times
    noise_values: Any  # real [Q, 2]: current and amplitude; scale of a Gaussian one; kick, and below what it comes
    uniform: Any  # where among these the uniform ones end
    gaussian: Any  # where the Gaussian ones do, behind which are kicks
    projections: Any  # int64 [P, 9]
    listed: Any  # int64, projections that learn and are lists
    sent: Any  # int64, projections that are in no matrix
    matrices: Any  # int64 [D, 10]
    members: Any  # int64 [E, 3], projections in matrices
    tiles: Any  # how many a trial's matrices have
    tile_rows: Any  # how many rows of tiles
    rises: Any  # how many reals their rows have, each once
    source: Any  # int32 [S], a synapse's presynaptic place
    target: Any  # int32 [S], its postsynaptic place
    rows: Any  # int64, offsets of each presynaptic neuron's synapses, by projection, trial and neuron
    columns: Any  # int64, offsets into `incoming` of each postsynaptic neuron's synapses, of those that learn
    incoming: Any  # int32, synapses ordered by postsynaptic neuron
    dense: Any  # how many reals a trial's dense rows take
    rules: Any  # int64 [R, 8]
    windows: Any  # real, the windows of all rules end to end
    bounds: Any  # real, the further arguments of all weight rules
    least: Any  # real [R], the least weight
    most: Any  # real [R], the weight above which it cannot rise
    longest: Any  # ms between two points at which all tensors are up to date, at most MILLISECONDS
    fading: Any  # real [R, MILLISECONDS + 1], decay^k; beyond `longest` of no use
    growing: Any  # real [R, MILLISECONDS + 1], decay^-k
    signals: Any  # real [Sg, M, but at least 1], factor of each modulator in what synapses of one rule listen to
    signal_rule: Any  # int64 [Sg]
    headroom: Any  # real, the most that a spike can add to all eligibilities
    set_limit: Any  # float64 [B, K]
    set_step: Any  # real [K]
    set_always: Any  # bool [K], whether its mean may rise in a way that no sum foretells
    modulators: Any  # int64 [M, 8]
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
    described: np.ndarray  # int64 [P, 9], without rules, signals and sets
    settled: np.ndarray  # real [S], zeros for engines to work with


def real_of(network: Network) -> Any:
    """NumPy's type of a network's real numbers."""
    return np.float64 if network.dtype == torch.float64 else np.float32


def topology(network: Network, lanes: int, lists: bool = True) -> Topology:
    """Where neurons and synapses stand; without `lists` not each synapse, which an engine may not need."""
    places = _places(network, lanes)
    if not lists:
        empty = {name: np.zeros(0, np.int32) for name in ("source", "target", "rows", "columns", "incoming")}
        ends = [[list(network.groups).index(name) for name in (p.pre, p.post)] for p in network.projections.values()]
        described = np.full((len(ends), 9), NONE, np.int64)
        described[:, [PRE, POST]] = np.array(ends, np.int64).reshape(-1, 2)
        return Topology(places, {**empty, "dense": 0}, described, np.zeros(0, real_of(network)))
    settled = np.zeros(network.synapses.plastic, real_of(network))
    return Topology(places, *_synapses(network, places["groups"], lanes), settled)


def tables(network: Network, known: Topology, lanes: int) -> tuple[Tables, Functions]:
    """The tables of a network as it is now; what `topology` gave is not made anew."""
    real = np.dtype(real_of(network))
    rules, signals, described = _learning(network, known.described)
    largest = max((float(w.abs().max()) for rule in rules for w in (rule.gains, rule.losses)), default=0.0)
    fans = [max(p.shape[1:]) for p in network.projections.values() if p.plastic]
    weight_rules = tuple(dict.fromkeys((rule.weight_rule, len(rule.bounds)) for rule in rules))
    releases = tuple(
        dict.fromkeys((m.released, len(m.sources), len(m.further)) for m in network.modulators.values() if m.sources)
    )
    names = list(network.modulators) or ["nothing"]
    sets = list(network.homeostasis.values())
    values = {
        "projections": described,
        **_matrices(described, known.places, lanes),
        **_rules(rules, weight_rules, real),
        "signals": np.array([[listens.get(name, 0.0) for name in names] for _, listens in signals], real).reshape(
            len(signals), len(names)
        ),
        "signal_rule": np.array([rule for rule, _ in signals], np.int64),
        "headroom": real.type(2 * largest * sum(fans)),
        "set_limit": np.stack([(s.limit * network.set_size(s)).cpu().numpy() for s in sets], 1)
        if sets
        else np.zeros((network.trials, 0)),
        "set_step": np.array([s.step for s in sets], real),
        "set_always": np.array([not all(_foretold(network, name) for name in s.projections) for s in sets], bool),
        **_modulators(network, releases, real),
        "gain": real.type(network.synaptic_gain),
        "trials": network.draws.trials.cpu().numpy(),
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


def _matrices(described: np.ndarray, places: dict[str, Any], lanes: int) -> dict[str, Any]:
    """The dense projections that learn, those onto one group that do it alike side by side."""
    alike: dict[tuple[int, ...], list[int]] = {}
    listed, sent = [], []
    for k, row in enumerate(described.tolist()):
        learns, is_list = row[RULE] != NONE, row[COLUMNS] != NONE
        if learns and not is_list:
            alike.setdefault((row[POST], row[RULE], row[SIGNAL], row[SET]), []).append(k)
        else:
            sent.append(k)
            listed += [k] if learns else []
    matrices: list[tuple[int, ...]] = []
    members: list[tuple[int, ...]] = []
    tile, rise, row = 0, places["places"], 0
    for (post, *learning), inside in alike.items():
        first, slot = len(members), 0
        for k in inside:
            pre = described[k, PRE]
            members.append((pre, slot, k))
            slot += places["groups"][pre, SIZE]
        width = -(-slot // lanes)
        matrices.append((post, *learning, tile, width, rise, row, first, len(members)))
        size = places["groups"][post, SIZE]
        tile, rise, row = tile + width * size, rise + width * lanes, row + size
    return {
        "listed": np.array(listed, np.int64),
        "sent": np.array(sent, np.int64),
        "matrices": np.array(matrices, np.int64).reshape(-1, 10),
        "members": np.array(members, np.int64).reshape(-1, 3),
        "tiles": tile,
        "tile_rows": row,
        "rises": rise - places["places"],
    }


def _synapses(network: Network, groups: np.ndarray, lanes: int) -> tuple[dict[str, Any], np.ndarray]:
    place = {name: k for k, name in enumerate(network.groups)}
    shift = np.concatenate([np.full(size, at - start) for size, start, at in groups])
    rows, columns, incoming, described = [], [], [], []
    row, column, synapse, entry, dense = 0, 0, 0, 0, 0
    for projection in network.projections.values():
        trials, pre_size, post_size = projection.shape
        source = (projection.trial * pre_size + projection.pre_index).cpu().numpy()
        rows.append(synapse + np.searchsorted(source, np.arange(trials * pre_size)))
        column_at, dense_at = NONE, NONE
        if _is_dense(projection) and not projection.plastic:
            dense_at, dense = dense, dense + pre_size * -(-post_size // lanes) * lanes
        elif projection.plastic and not _is_dense(projection):
            target = (projection.trial * post_size + projection.post_index).cpu().numpy()
            order = np.argsort(target, kind="stable")
            columns.append(entry + np.searchsorted(target[order], np.arange(trials * post_size)))
            incoming.append(synapse + order)
            column_at, column, entry = column, column + trials * post_size, entry + len(order)
        ends = place[projection.pre], place[projection.post]
        described.append((*ends, projection.delay, NONE, NONE, NONE, row, column_at, dense_at))
        row, synapse = row + trials * pre_size, synapse + len(source)
    neurons = [(ends % network.size).cpu().numpy() for ends in (network.synapses.pre, network.synapses.post)]
    found = {
        "source": (neurons[0] + shift[neurons[0]]).astype(np.int32),
        "target": (neurons[1] + shift[neurons[1]]).astype(np.int32),
        "rows": _joined([*rows, [synapse]], np.int64),
        "columns": _joined([*columns, [entry]], np.int64),
        "incoming": _joined(incoming, np.int32),
        "dense": dense,
    }
    return found, np.array(described, np.int64).reshape(-1, 9)


def _is_dense(projection: Projection) -> bool:
    trials, pre_size, post_size = projection.shape
    pairs = pre_size * post_size
    return len(projection.weight) >= DENSE * trials * pairs and 2 * pairs * projection.weight.itemsize <= LARGEST


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
    longest = min([MILLISECONDS, *(max(1, int(DECAYS * rule.tau_eligibility)) for rule in rules)])
    powers = [np.cumprod([1.0, *[rule.decay] * longest, *[1.0] * (MILLISECONDS - longest)]) for rule in rules]
    return {
        "rules": np.array(described, np.int64).reshape(-1, 8),
        "windows": _joined(windows, real),
        "bounds": np.array(bounds, real),
        "least": np.array([rule.weight_min for rule in rules], real),
        "most": np.array([rule.weight_max if rule.adds_up else math.inf for rule in rules], real),
        "longest": longest,
        "fading": np.array(powers, real).reshape(-1, MILLISECONDS + 1),
        "growing": 1 / np.array(powers, real).reshape(-1, MILLISECONDS + 1),
    }


def _modulators(network: Network, releases: tuple[Any, ...], real: Any) -> dict[str, Any]:
    place = {name: k for k, name in enumerate(network.groups)}
    described, values, ring = [], [], 0
    sources: list[int] = []
    further: list[float] = []
    for m in network.modulators.values():
        released = releases.index((m.released, len(m.sources), len(m.further))) if m.sources else NONE
        ends = len(sources), len(sources) + len(m.sources)
        described.append((m.delay, m.signed, m.smoothing > 0, released, *ends, len(further), ring))
        ring += len(m.sources) * m.delay
        values.append((m.baseline, m.decay, m.fading, m.reward))
        sources += [place[name] for name in m.sources.values()]
        further += m.further if m.sources else ()
    return {
        "modulators": np.array(described, np.int64).reshape(-1, 8),
        "modulator_values": np.array(values, real).reshape(-1, 4),
        "sources": np.array(sources, np.int64),
        "further": np.array(further, real),
    }


def _background(network: Network, places: dict[str, Any], lanes: int, real: Any) -> dict[str, Any]:
    constant = np.zeros(places["places"], real)
    restless = np.zeros(places["places"] // lanes, bool)
    named = list(zip(network.groups.values(), places["groups"].tolist(), strict=True))
    for group, (size, _, at) in named:
        constant[at : at + size] = group.current
        if group.restless:
            restless[at // lanes : (at + size - 1) // lanes + 1] = True
    before = np.cumsum(restless) - restless  # restless blocks before each
    drawn: dict[str, list[tuple[Any, ...]]] = {"background": [], "gaussian": [], "kicks": []}
    for number, (group, (size, _, at)) in enumerate(named):
        place = before[at // lanes] * lanes + at % lanes
        for kind, needed, *value in (
            ("background", group.restless, group.current, group.noise),
            ("gaussian", group.gaussian, group.gaussian_scale, 0.0),
            ("kicks", group.kicked_below, group.kick, group.kicked_below),
        ):
            if needed:
                drawn[kind].append((place, size, stream(kind, group.name), number, *value))
    noises = [row for rows in drawn.values() for row in rows]
    blocks = np.arange(len(restless))
    return {
        "background": constant,
        "background_at": np.where(restless, places["places"] + before * lanes, blocks * lanes),
        "background_step": np.where(restless, restless.sum() * lanes, 0),
        "noises": np.array([row[:4] for row in noises], np.int64).reshape(-1, 4),
        "noise_values": np.array([row[4:] for row in noises], real).reshape(-1, 2),
        "uniform": len(drawn["background"]),
        "gaussian": len(drawn["background"]) + len(drawn["gaussian"]),
    }


def _joined(parts: list[Any], dtype: Any) -> Any:
    return np.concatenate([np.zeros(0, dtype), *parts]).astype(dtype)
