"""What loggers are shown of a run, by tags: numbers of a moment, weights; its charts, and its hyperparameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from snnrl.model.synapses import Projection
from snnrl.recording.logger import Chart, Histogram
from snnrl.recording.probes import ELIGIBILITY, WEIGHT, Probe, readable
from snnrl.simulation import Simulation

ALARMS = "alarms, trials"
OF_ROLE = "weight of role, mV"
WEIGHTS = "weights of all trials, mV"  # a tag of its own: TensorBoard takes one for one kind of data
SPREAD = "spread over trials"
QUANTILES = {"median": 0.5, "10 %": 0.1, "90 %": 0.9}
WITHOUT_EFFECT = ("threads", "record.", "checkpoint.")
ALWAYS = ("seed", "trials", "seconds", "network.synaptic_gain", "network.plasticity.", "network.dopamine.")


def roles(followed: Sequence[Projection]) -> dict[str, list[int]]:
    """By the tag of each role, the places of its projections."""
    found: dict[str, list[int]] = {}
    for place, projection in enumerate(followed):
        found.setdefault(f"{OF_ROLE}/{readable(projection.role)}", []).append(place)
    return found


def means(tags: Sequence[str], values: np.ndarray) -> dict[str, float]:
    """Over trials, of values [B] or [B, parts], a tag for each part."""
    return dict(zip(tags, np.atleast_1d(values.mean(0)).tolist(), strict=True))


def spread(tag: str, values: np.ndarray) -> dict[str, float]:
    """Quantiles over the trials of values [B]; none of a single trial."""
    if len(values) == 1:
        return {}
    return dict(zip(quantile_tags(tag), np.quantile(values, list(QUANTILES.values())).tolist(), strict=True))


def quantile_tags(tag: str) -> tuple[str, ...]:
    """Those of the median and the 10 and 90 % quantiles of what has a tag, in a group beside the tag's."""
    group, _, name = tag.partition("/")
    return tuple(f"{group}, {SPREAD}/{name}, {quantile}" for quantile in QUANTILES)


def histograms(followed: Sequence[Projection]) -> dict[str, Histogram]:
    """The weights (mV) of each projection, over all trials."""
    found = {}
    for projection in followed:
        weights = projection.weight.double().cpu().numpy()
        weights = weights[np.isfinite(weights)]
        if len(weights):
            most = weights.max() if projection.rule is None else projection.rule.weight_max
            found[f"{WEIGHTS}/{readable(projection.name)}"] = Histogram(weights, 0.0, most)
    return found


def charts(
    simulation: Simulation[Any], probes: Sequence[Probe], followed: Sequence[Projection]
) -> dict[str, list[Chart]]:
    """A category for each taxis, its attraction against its avoidance, and one for what is spread over trials."""
    found = _taxes(followed)
    spreading = [tag for probe in probes if probe.spread for tag in probe.tags(simulation)]
    spreading += roles(followed)
    if simulation.trials > 1 and spreading:
        bands = [Chart(f"{tag}: median, 10 to 90 % of trials", quantile_tags(tag), band=True) for tag in spreading]
        found[SPREAD] = bands
    return found


def _taxes(followed: Sequence[Projection]) -> dict[str, list[Chart]]:
    known = {projection.role for projection in followed}
    categories = {}
    for taxis in sorted({role.removesuffix("_attraction") for role in known if role.endswith("_attraction")}):
        pair = [f"{taxis}_attraction", f"{taxis}_avoidance"]
        if not known.issuperset(pair):
            continue
        title = f"{readable(taxis)}: attraction against avoidance, mean weight (mV)"
        found = [Chart(title, tuple(f"{OF_ROLE}/{readable(role)}" for role in pair))]
        for role in pair:
            names = [readable(projection.name) for projection in followed if projection.role == role]
            for tag, what in ((WEIGHT, "weight of each projection (mV)"), (ELIGIBILITY, "eligibility of each one")):
                found.append(Chart(f"{readable(role)}: {what}", tuple(f"{tag}/{name}" for name in names)))
        categories[f"{readable(taxis)} taxis"] = found
    return categories


def choices(settings: Mapping[str, Any], overrides: Iterable[str]) -> dict[str, str | float]:
    """A run's hyperparameters: what its command line has chosen that may change a result, and what there always is.

    Args:
        settings: all of its configuration, by key.
    """
    chosen: dict[str, str | float] = {
        "experiment": settings["experiment.name"],
        "robot": settings["robot.name"],
        **{key: value for key, value in settings.items() if key.startswith(ALWAYS) and _is_number(value)},
    }
    for override in overrides:
        key, _, text = override.lstrip("+~").partition("=")
        if not key.startswith(WITHOUT_EFFECT) and key not in chosen:
            try:
                chosen[key] = float(text)
            except ValueError:
                chosen[key] = text
    return chosen


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
