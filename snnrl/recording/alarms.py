"""Alarms: trials in which something has gone wrong, noticed while the run goes on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from snnrl.model.synapses import totals
from snnrl.schema import AlarmsConfig
from snnrl.simulation import Simulation

KINDS = ("silent", "saturated", "synchronised", "non-finite")
POINTS = 30  # in time, of a correlation
SIDES = ("attraction", "avoidance")


class Alarms:
    """Flags trials, once each for every kind of alarm.

    - silent: a motor group has not fired for `silent` s.
    - saturated: more than this share of the plastic weights is at the upper bound. The lower bound is no sign
      of failure: weights may start there, and in a robot that has learnt the losing ones return to it.
    - synchronised: over the last `synchronised_over` s (or POINTS samples, if that is longer) the mean weights
      of attraction and avoidance of a taxis (roles NAME_attraction, NAME_avoidance) are correlated by more than
      `synchronised`, both exceed `synchronised_above` on average, and attraction does not lead by the factor
      `synchronised_lead` (how trials fail, thesis 4.5; trials that learn are correlated too while they begin).
    - non-finite: potential, recovery, weight, eligibility or dopamine is infinite or not a number.

    Args:
        config: the thresholds; all but non-finite values can be left out.
        simulation: whose trials are watched.
        roles: of the projections that `check` is given the mean weights of.
        state: what `state_dict` gave.

    Attributes:
        first: for each of KINDS when each trial was flagged, float64 [B], s; nan if it was not.
    """

    def __init__(
        self,
        config: AlarmsConfig,
        simulation: Simulation,
        roles: list[str],
        state: Mapping[str, Any] | None = None,
    ) -> None:
        self.config, self.simulation = config, simulation
        never = torch.full((simulation.trials,), torch.nan, dtype=torch.float64)
        self.first = {kind: never.clone() for kind in KINDS}
        self._spikes = self._motor_spikes()
        self._heard = torch.full(self._spikes.shape, self._now(), dtype=torch.float64)  # s, [B, motors]
        self._plastic = [p for p in simulation.network.projections.values() if p.plastic]
        if self._plastic:
            self._least_bound = min(p.rule.weight_max for p in self._plastic if p.rule)
            self._synapses = torch.stack([p.count for p in self._plastic]).sum(0)
        self._taxes = {}
        for role in roles:
            taxis, _, kind = role.rpartition("_")
            if kind == "attraction" and f"{taxis}_avoidance" in roles:
                pair = [[k for k, name in enumerate(roles) if name == f"{taxis}_{side}"] for side in SIDES]
                self._taxes[taxis] = pair
        if state is not None:
            self.first, self._spikes, self._heard = dict(state["first"]), state["spikes"], state["heard"]

    def state_dict(self) -> dict[str, Any]:
        return {"first": self.first, "spikes": self._spikes, "heard": self._heard}

    def counts(self) -> dict[str, int]:
        """How many trials have been flagged, for the kinds that have occurred."""
        counts = {kind: int((~first.isnan()).sum()) for kind, first in self.first.items()}
        return {kind: count for kind, count in counts.items() if count}

    def check(self, weight: Tensor) -> list[str]:
        """Look at the simulation as it is now; the kinds that have occurred for the first time.

        Args:
            weight: mean weights (mV) at up to POINTS samples until now, [T, B, P] with a P for each of the roles.
        """
        new = []
        found = {
            "silent": self._silent(),
            "saturated": self._saturated(),
            "synchronised": self._synchronised(weight),
            "non-finite": self._non_finite(),
        }
        for kind, flagged in found.items():
            if flagged.any():
                new += [kind] if self.first[kind].isnan().all() else []
                self.first[kind][flagged.cpu() & self.first[kind].isnan()] = self._now()
        return new

    def explain(self, kind: str) -> str:
        """What an alarm has found so far, in a line."""
        config, network = self.config, self.simulation.network
        reason = {
            "silent": f"a motor group without a spike for {config.silent} s",
            "saturated": f"more than {100 * (config.saturated or 0.0):g} % of the plastic weights at their upper bound",
            "synchronised": "attraction and avoidance of a taxis rise and fall together, and neither leads",
            "non-finite": "infinite values, or values that are no numbers",
        }
        return f"{self.counts()[kind]} of {network.trials} trials {kind} at {self._now():.0f} s: {reason[kind]}"

    def summary(self) -> dict[str, Any]:
        """For each kind that has occurred, when it first did (s), and the numbers of the trials."""
        numbers = self.simulation.network.draws.trials.cpu()
        return {
            kind: {"first_s": float(first[~first.isnan()].min()), "trials": numbers[~first.isnan()].tolist()}
            for kind, first in self.first.items()
            if not first.isnan().all()
        }

    def _now(self) -> float:
        return int(self.simulation.network.time) / 1000.0

    def _motor_spikes(self) -> Tensor:
        return self.simulation.network.spike_count[:, self.simulation.situation.coding.motor_groups].cpu()

    def _silent(self) -> Tensor:
        spikes = self._motor_spikes()
        self._heard[spikes > self._spikes] = self._now()
        self._spikes = spikes
        if self.config.silent is None:
            return torch.zeros(len(spikes), dtype=torch.bool)
        return (self._now() - self._heard >= self.config.silent).any(1)

    def _saturated(self) -> Tensor:
        network = self.simulation.network
        if self.config.saturated is None or not self._plastic:
            return torch.zeros(network.trials, dtype=torch.bool)
        share, weight = self.config.saturated, network.synapses.weight[: network.synapses.plastic]
        if int((weight >= self._least_bound).sum()) <= share * int(self._synapses.min()):
            return torch.zeros(network.trials, dtype=torch.bool)  # as nearly always
        full = totals(self._plastic, [p.weight >= p.rule.weight_max for p in self._plastic if p.rule]).sum(0)
        return full > share * self._synapses

    def _synchronised(self, weight: Tensor) -> Tensor:
        flagged = torch.zeros(self.simulation.trials, dtype=torch.bool)
        if self.config.synchronised is None or len(weight) < POINTS:
            return flagged
        if float(weight.max()) <= self.config.synchronised_above:
            return flagged  # no mean is above that
        for pair in self._taxes.values():
            means = torch.stack([weight[:, :, places].double().mean(2) for places in pair])  # [2, T, B]
            attraction, avoidance = means.mean(1)
            strong = torch.minimum(attraction, avoidance) > self.config.synchronised_above
            strong &= attraction <= self.config.synchronised_lead * avoidance
            if not strong.any():
                continue
            centred = means - means.mean(1, keepdim=True)
            correlation = centred.prod(0).sum(0) / centred.pow(2).sum(1).prod(0).sqrt()  # nan where one is constant
            flagged |= strong & (correlation > self.config.synchronised)
        return flagged

    def _non_finite(self) -> Tensor:
        network = self.simulation.network
        table, neurons = network.synapses, network.neurons
        levels = [modulator.level for modulator in network.modulators.values()]
        sums = (float(values.sum()) for values in (neurons.v, neurons.u, table.weight, table.eligibility, *levels))
        if math.isfinite(sum(sums)):
            return torch.zeros(network.trials, dtype=torch.bool)  # what is infinite or no number makes a sum so
        finite = (neurons.v.isfinite() & neurons.u.isfinite()).all(1)
        for level in levels:
            finite &= level.isfinite()
        finite[table.trial[~(table.weight.isfinite() & table.eligibility.isfinite())]] = False
        return ~finite
