"""Dose, hunger, and where robots learn by both."""

from __future__ import annotations

import numpy as np
import pytest

from snnrl.beyond import regimes
from snnrl.beyond.regimes import dose_and_threshold, make, run
from snnrl.configuration.compose import compose

STILL = ("+experiment=food_attraction", "robot=random_walk", "trials=3", "seconds=70", "threads=1")


def measured(*overrides: str) -> tuple[float, float]:
    return dose_and_threshold(*run(compose(*STILL, *overrides), 1.0))


def test_the_dose_is_in_proportion_to_the_release_and_the_threshold_does_not_depend_on_it() -> None:
    none, once, twice = (measured(f"network.dopamine.release={release}") for release in (0.0, 0.002, 0.004))
    assert none[0] == pytest.approx(0.0, abs=1e-3)
    assert once[0] > 0.1
    assert twice[0] == pytest.approx(2 * once[0], rel=1e-3)
    assert none[1] == once[1] == twice[1]


def test_the_threshold_is_what_hunger_takes_between_two_items() -> None:
    config = compose(*STILL)
    simulation, _ = run(config, 1.0)
    items = float(simulation.situation.world.count("food").double().mean())
    dose, threshold = dose_and_threshold(simulation, config)
    assert threshold == pytest.approx(0.0004 * float(simulation.network.time) / items)
    dopamine = simulation.network.dopamine
    assert dopamine is not None
    assert dose - threshold == pytest.approx(float(dopamine.total.double().mean()) / items, abs=1e-3)


def test_every_point_of_both_worlds_is_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(regimes, "RELEASE", (1.0, 2.0))
    monkeypatch.setattr(regimes, "EXPLORATION", (0.8, 1.0))
    found = regimes.regimes(*regimes.WORLDS["food"], ("trials=2", "threads=1"), 0.02)
    np.testing.assert_allclose(found.gain[0] / found.gain[1], 0.8)
    np.testing.assert_allclose(found.dose[:, 1], 2 * found.dose[:, 0])
    assert ((found.learnt >= 0) & (found.learnt <= 1)).all()
    rows = make(("trials=2", "threads=1"), 0.02).table.splitlines()[2:]
    assert [row.split(" | ")[0] for row in rows] == ["| food", "| food", *["| food in containers"] * 2]
