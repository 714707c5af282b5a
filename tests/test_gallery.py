"""What the figures show and their captions say, on hand-made runs."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers import compose_config, hand_made, with_weights

from snnrl.configuration.builder import build
from snnrl.recording.runs import Run
from snnrl.thesis import dampening
from snnrl.thesis.dampening import Dampened, dampened
from snnrl.thesis.figures import failure
from snnrl.thesis.gallery import DRAWINGS

SIDES = {"left": "right", "right": "left"}


def caption(name: str, runs: dict[str, Run]) -> str:
    return next(drawing for drawing in DRAWINGS if drawing.name == name).told(runs)


def test_the_dampening_close_up_starts_below_the_limit_and_within_one_step() -> None:
    network = build(compose_config("+experiment=food_attraction", *dampening.overrides())).network
    [homeostasis] = network.homeostasis.values()
    projections = [network.projections[name] for name in homeostasis.projections]
    mean = torch.stack([p.total(p.weight) for p in projections]).sum(0) / network.set_size(homeostasis)
    assert (mean < homeostasis.limit).all()
    assert (mean > homeostasis.limit - 1.5 * homeostasis.step).all()


def test_a_fall_is_a_step_of_both_halves_from_near_the_limit() -> None:
    rows = [  # attraction, avoidance; limit 2 and step 0.1
        (2.00, 1.98),
        (1.91, 1.89),  # both by a step, from the limit
        (1.97, 1.95),
        (1.90, 1.93),  # avoidance by less than half a step
        (1.80, 1.83),  # from the limit's neighbourhood: 1.915
        (1.70, 1.73),  # as much again, but from further below
    ]
    attraction, avoidance = np.array(rows).T[:, :, None]
    seen = Dampened(attraction, avoidance, 0.5 * (attraction + avoidance), limit=2.0, step=0.1)
    assert seen.falls[:, 0].tolist() == [False, True, False, False, True, False]


@pytest.mark.parametrize(("count_absent", "mean"), [(True, 1.0), (False, 2.0)])
def test_the_mean_that_homeostasis_sees(count_absent: bool, mean: float) -> None:
    """Half of the pairs are joined; weights of 2 mV for attraction, 2 mV for avoidance."""
    names = [f"{side}_food_to_{motor}_motor" for side in SIDES for motor in SIDES]
    run = with_weights(np.array([1.0, 2.0]), **dict.fromkeys(names, np.ones((2, 1))))
    joined = np.array([[[2.0, np.nan], [np.nan, 2.0]]])
    settings = {"limit": 2.0, "step": 0.1, "count_absent": count_absent}
    run.__dict__.update(weights=dict.fromkeys(names, joined), config={"network": {"homeostasis": settings}})
    seen = dampened(run)
    for values in (seen.attraction, seen.avoidance, seen.mean):
        assert values == pytest.approx(np.full((2, 1), mean))


def failing(left: tuple[float, float], right: tuple[float, float], correct: float, trial: int = 7) -> Run:
    """One trial that ends with so much attraction and avoidance of containers on each side."""
    ends = {"left": left, "right": right}
    names = {
        f"{side}_container_to_{SIDES[side] if k == 0 else side}_motor": np.array([[0.0], [ends[side][k]]])
        for side in SIDES
        for k in (0, 1)
    }
    run = with_weights(np.array([1.0, 2.0]), **names)
    run.__dict__["trials"] = {"correct": np.array([correct]), "trial": np.array([float(trial)])}
    return run


FIXED, DUAL = "secondary_behaviour/fixed_container_dopamine", "dual_learning/learning"


def test_the_failing_trial_is_told_with_its_run_side_and_criterion() -> None:
    runs = {FIXED: failing((2.0, 0.1), (1.0, 0.95), 0.0), DUAL: failing((0.1, 0.0), (2.0, 0.0), 0.0)}
    assert failure(runs) == (FIXED, 0, "right")
    text = caption("failing_trial", runs)
    assert "trial 7 of fixed container dopamine in secondary behaviour, right side" in text
    assert "0.5 mV" in text
    assert "1.1 times" in text


def test_a_trial_that_fails_by_its_food_taxis_is_not_shown_as_one_that_fails_by_containers() -> None:
    learnt, by_food = failing((2.0, 0.1), (2.0, 0.1), 1.0), failing((2.0, 0.1), (2.0, 0.1), 0.0)
    assert failure({FIXED: learnt, DUAL: by_food}) is None
    assert failure({FIXED: learnt, DUAL: failing((2.0, 0.1), (0.5, 0.1), 0.0)}) == (DUAL, 0, "right")


def test_captions_give_the_lengths_of_the_runs() -> None:
    config = {"seconds": 12.0, "world": {"kinds": {"food": {"poison_from": 34.0}}}}
    run = hand_made(config=config, series={"time": np.array([0.1, 0.2, 0.3])})
    assert "for 12 s" in caption("random_walk", {"random_walk": run})
    assert "first 12 s" in caption("first_eligibility", {"first_eligibility": run})
    assert "first 12 s" in caption("single_trial", {"single_trial": run})
    assert "from 34 s on" in caption("poison_rates", {"food_poison/learning": run})
    assert "every 100 ms" in caption("orbit_path", {"orbit/learning": run})
    assert "mean of 0.5 s" in caption("orbit_firing", {"orbit/learning": run})
    coarse = hand_made(config=config, series={"time": np.array([0.2, 0.4])})
    assert "mean of 0.4 s" in caption("orbit_firing", {"orbit/learning": coarse})
