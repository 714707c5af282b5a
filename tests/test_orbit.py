"""The orbit that a robot cannot leave by itself."""

from __future__ import annotations

import pytest
import torch
from helpers import compose_config

from snnrl.body.world.geometry import offset, orbit
from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.errors import ConfigError


def test_an_attracted_robot_stays_on_its_orbit_round_the_item() -> None:
    run = build(compose_config("+experiment=orbit", "robot=learning_disabled", "trials=5", "dtype=float64"))
    coding, world = run.situation.coding, run.situation.world
    radius, turn = orbit(coding.config.slow, coding.config.fast, coding.tick / 1000, world.config.axle)
    assert (radius, turn) == (pytest.approx(4.568, abs=1e-3), pytest.approx(0.434))
    engine = make_engine("fused", "cpu")
    headings = []
    for _ in range(60):
        run.run(engine, 1)
        distance = offset(world.position, world.places[:, 0], world.config.side).norm(dim=1)
        torch.testing.assert_close(distance, torch.full((5,), radius, dtype=torch.float64))
        headings.append(world.heading.clone())
    turns = torch.stack(headings).diff(dim=0) % (2 * torch.pi)
    torch.testing.assert_close(turns, torch.full_like(turns, turn))


def test_only_hunger_breaks_the_orbit() -> None:
    collected = {}
    for robot in ("learning_disabled", "learning", "positive_baseline"):
        config = compose_config("+experiment=orbit", f"robot={robot}")
        run = build(config)
        run.run(make_engine("fused", "cpu"), round(1000 * config.seconds / run.situation.coding.tick))
        collected[robot] = int((run.situation.world.count("food") > 0).sum())
    assert collected["learning_disabled"] == 0
    assert collected["learning"] >= 18
    assert collected["positive_baseline"] == 0


def test_an_orbit_needs_an_item_and_wheels_that_differ() -> None:
    for override in ("world.kinds.food.count=0", "coding.slow=31.2"):
        with pytest.raises(ConfigError, match=r"world\.orbiting=True: needs"):
            build(compose_config("+experiment=orbit", override))
