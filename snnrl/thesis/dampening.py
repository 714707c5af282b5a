"""A close-up in which dampening (thesis 3.9) must act: all weights of the food taxis start just below its limit.

In the reported runs the mean of a set reaches its limit in some trials, now and then, between two samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from snnrl.configuration.compose import compose
from snnrl.configuration.parts import homeostatic_set
from snnrl.recording.runs import Run
from snnrl.thesis.claims import pathways

EXPERIMENT, SET = "food_attraction", "food_taxis"


def overrides() -> tuple[str, ...]:
    """Of the close-up: attraction and avoidance start alike, one step below the limit of their mean."""
    network = compose(f"+experiment={EXPERIMENT}").network
    assert network.homeostasis is not None
    roles, homeostasis = network.homeostasis.sets[SET], homeostatic_set(network.homeostasis, SET)
    assert homeostasis.limit is not None
    assert homeostasis.step is not None
    joined = network.synapses["taxis"].probability if homeostasis.count_absent else 1.0
    start = (homeostasis.limit - homeostasis.step) / (joined or 1.0)
    return ("trials=8", "seconds=30", *(f"+robot.weights.{role}={start:.4g}" for role in roles))


@dataclass(frozen=True)
class Dampened:
    """Mean weights (mV) of the food taxis as homeostasis sees them, by sample and trial, [T, B].

    Attributes:
        attraction, avoidance: the two halves of the set. mean: of the whole set.
        limit, step: of homeostasis, mV.
    """

    attraction: np.ndarray
    avoidance: np.ndarray
    mean: np.ndarray
    limit: float
    step: float

    @property
    def falls(self) -> np.ndarray:
        """Samples just before which the set was dampened, bool [T, B].

        The mean was less than a step from its limit, and then both halves lost most of a step at once; the rest of it
        was learnt anew in the same tick.
        """
        halves = np.stack([self.attraction, self.avoidance])
        lost = np.all(np.diff(halves, axis=1) < -0.5 * self.step, 0)
        near = self.mean[:-1] > self.limit - self.step
        return np.concatenate([np.zeros_like(near[:1]), near & lost])


def dampened(run: Run) -> Dampened:
    """What a run says of it; all projections of the set have as many pairs of neurons."""
    homeostasis = run.config["network"]["homeostasis"]
    own = homeostasis.get("per_set", {}).get(SET, {})
    homeostasis = {**homeostasis, **{key: value for key, value in own.items() if value is not None}}

    def joined(name: str) -> np.ndarray:
        return (~np.isnan(run.weights[name])).mean((1, 2)) if not homeostasis["count_absent"] else np.ones(1)

    names = [pathways("food", response) for response in ("attraction", "avoidance")]
    total = [np.sum([run.of_projection("weight", name) for name in half], 0) for half in names]
    size = [np.sum([joined(name) for name in half], 0) for half in names]
    attraction, avoidance = (part / n for part, n in zip(total, size, strict=True))
    return Dampened(attraction, avoidance, sum(total) / sum(size), homeostasis["limit"], homeostasis["step"])
