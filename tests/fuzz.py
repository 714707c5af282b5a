"""Configurations gone wrong: a small valid one, and seeded ways to spoil it."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Iterator
from typing import Any

Tree = dict[str, Any]

VALID: Tree = {
    "experiment": {"name": "fuzz", "robots": ["learning"], "correct": {"food": "together"}},
    "robot": {"name": "learning", "learning": True, "weights": {"food_attraction": 1.0}, "fixed": ["reward"]},
    "network": {
        "neurons": {
            "regular": {"a": 0.02, "b": 0.2, "c": -65.0, "d": 8.0, "c_spread": 15.0, "d_spread": -6.0, "v": -65.0}
        },
        "synapses": {
            "taxis": {"probability": 0.85, "weight": 0.0, "plastic": True, "delay": 2},
            "reward": {"probability": 0.5, "weight": 3.0, "spread": 0.5},
        },
        "groups": {
            "left": {"size": 3, "neuron": "regular"},
            "right": {"size": 3, "neuron": "regular"},
            "motor": {"size": 2, "neuron": "regular", "current": 3.0},
            "other": {"size": 2, "neuron": "regular"},
            "dopa": {
                "size": 4,
                "neuron": "regular",
                "current": 3.65,
                "noise": 0.28,
                "gaussian": 0.1,
                "kick": 20.0,
                "kick_rate": 0.4,
            },
        },
        "projections": {
            "one": {"pre": "left", "post": "motor", "synapse": "taxis", "role": "food_attraction"},
            "two": {"pre": "right", "post": "other", "synapse": "taxis", "role": "food_avoidance"},
            "three": {"pre": "left", "post": "dopa", "synapse": "reward", "role": "reward"},
        },
        "synaptic_gain": 4.0,
        "plasticity": {
            "potentiation": 0.1,
            "depression": 0.15,
            "tau_plus": 20.0,
            "tau_minus": 110.0,
            "tau_eligibility": 476.0,
            "weight_max": 4.0,
            "simultaneous": "depresses",
            "potentiation_from": "arrival",
        },
        "dopamine": {
            "source": "dopa",
            "baseline": -0.0004,
            "tau": 21.0,
            "release": 0.0035,
            "delay": 5,
            "threshold": 5,
        },
        "homeostasis": {
            "sets": {"taxis": ["food_attraction", "food_avoidance"]},
            "limit": 2.0,
            "step": 0.1,
            "per_set": {"taxis": {"limit": 1.5, "step": 0.2, "count_absent": False}},
        },
    },
    "coding": {
        "tick": 7,
        "range_mean": 30.0,
        "range_gain": 1.2,
        "touch_mean": 12.0,
        "touch_gain": 3.0,
        "gain_acts_on": "mean",
        "exploration": 2.35,
        "exploration_gain": 1.5,
        "exploration_drawn": "each_tick",
        "slow": 25.0,
        "fast": 31.2,
        "motors": {"left": "motor", "right": "other"},
        "ranges": {"food": {"left": "left", "right": "right"}},
        "touches": {"food": "left"},
    },
    "world": {
        "side": 100.0,
        "axle": 1.0,
        "kinds": {
            "food": {"count": 2, "radius": 2.4, "touched": "taken", "sign": 1, "poison_from": 0.01},
            "food_container": {
                "count": 1,
                "radius": 14.0,
                "touched": "entered",
                "holds": "food",
                "contains": "whole",
                "hides": True,
                "speed": 0.5,
                "opens": [],
                "avoids": ["robot", "containers"],
            },
            "empty_container": {"count": 1, "radius": 14.0, "touched": "entered", "speed": 0.5},
        },
        "ranges": {"food": {"reach": 30.0, "measured_to": "border", "sees": ["food"]}},
        "overlap": "nearest",
        "attempts": 3,
        "orbiting": False,
    },
    "record": {"every": 10.0, "tensorboard": False},
    "trials": 2,
    "trial_start": 0,
    "seconds": 1.0,
    "seed": 0,
    "engine": "fused",
    "device": "cpu",
    "dtype": "float32",
    "threads": 1,
}
NUMBERS = [
    0, 1, -1, 2, 3, 0.5, -0.0, 1e-9, -1e-9, 1e-300, 5e-324, 1e6, 1e9, 1e18, 1e300, -1e300, 2**31, 2**63,
    -(2**63), 2**64, 10**30, 10**400, float("nan"), float("inf"), -float("inf"),
]  # fmt: skip
WORDS = [
    "", " ", "nobody", "left", "motor", "a.b", "a/b", "../../etc/passwd", "keys", "type", "training", "forward",
    "_target_", "__class__", "???", "${seed}", "${nowhere}", "${oc.env:HOME}", "${", "nan", "1e3", "0x10", "true",
    "null", "\n", "a\nb", "\x00", "\u202e", "ñ", "神経", "🧠", "\ud800", "x" * 5000, "cuda:0", "mps", "meta", "cpu:7",
    "{}", "[]", "lambda: 0",
]  # fmt: skip
OTHERS: list[Any] = [
    None,
    True,
    False,
    [],
    {},
    [[]],
    [1, "a", None],
    {"a": 1},
    {"_target_": "os.system"},
    {1: 2},
    b"bytes",
]


def paths(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value in a tree of dictionaries and lists, inner ones included."""
    parts = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in parts:
        yield (*path, key)
        yield from paths(value, (*path, key))


def parent(tree: Tree, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        tree = tree[key]
    return tree


def number(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    parent(tree, path)[path[-1]] = draw.choice(NUMBERS)


def scaled(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    old = parent(tree, path)[path[-1]]
    if isinstance(old, (int, float)) and not isinstance(old, bool):
        parent(tree, path)[path[-1]] = type(old)(old * draw.choice([-1, 0, 2, 10, 1000, 10**6]))


def word(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    parent(tree, path)[path[-1]] = draw.choice(WORDS)


def other(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    parent(tree, path)[path[-1]] = copy.deepcopy(draw.choice(OTHERS))


def removed(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    del parent(tree, path)[path[-1]]


def renamed(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    holder = parent(tree, path)
    if isinstance(holder, dict):
        holder[draw.choice(WORDS)] = holder.pop(path[-1])


def added(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    holder = parent(tree, path)
    if isinstance(holder, dict):
        holder[draw.choice(WORDS)] = copy.deepcopy(draw.choice([*holder.values(), *OTHERS]))


def nested(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    value = parent(tree, path)[path[-1]]
    for _ in range(draw.choice([1, 2, 20])):
        value = draw.choice([[value], {"a": value}])
    parent(tree, path)[path[-1]] = value


def moved(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    source = draw.choice([p for p in paths(tree) if p[: len(path)] != path and path[: len(p)] != p])
    parent(tree, path)[path[-1]] = copy.deepcopy(parent(tree, source)[source[-1]])


def rewired(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    """A projection between any groups: onto itself, in a cycle, from a group to nowhere."""
    groups = tree["network"]["groups"]
    ends = {end: draw.choice([*groups, "nobody"]) for end in ("pre", "post")}
    tree["network"]["projections"][f"p{draw.randrange(9)}"] = {**ends, "synapse": draw.choice(["taxis", "reward"])}


def resized(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    groups = tree["network"]["groups"]
    groups[draw.choice(list(groups))]["size"] = draw.choice([0, 1, 7, 1000, 30_000, 1_000_000, 1_000_001, -1, 2**40])


def emptied(draw: random.Random, tree: Tree, path: tuple[Any, ...]) -> None:
    value = parent(tree, path)[path[-1]]
    if isinstance(value, (dict, list)):
        value.clear()


SPOILERS: list[Callable[[random.Random, Tree, tuple[Any, ...]], None]] = [
    number, number, scaled, scaled, word, word, other, removed, renamed, added, nested, moved, rewired, resized,
    emptied,
]  # fmt: skip


def case(seed: int) -> tuple[str, Tree]:
    """A spoilt configuration, and how it was spoilt."""
    draw, tree, done = random.Random(seed), copy.deepcopy(VALID), []
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        spoil = draw.choice(SPOILERS)
        path = draw.choice(list(paths(tree)))
        try:
            spoil(draw, tree, path)
        except (KeyError, TypeError, IndexError, AttributeError, OverflowError):
            continue  # an earlier step has taken away what this one works on
        done.append(f"{spoil.__name__} at {'.'.join(map(repr, path))}")
    return "; ".join(done), tree
