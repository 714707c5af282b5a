"""Recording beside a simulation: a copy of its state, work in a thread, and what goes wrong in it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
import torch
from helpers import SMALL_STIMULI, SMALL_TASK, make_simulation

from snnrl.engines import make_engine
from snnrl.running import beside
from snnrl.running.beside import Beside

CASES = {
    "robot": ("+experiment=dual_learning", "trials=3"),
    "watched synapse": ("+experiment=distal_reward", *SMALL_TASK, "trials=2"),
    "stimuli": ("+experiment=classical_conditioning", *SMALL_TASK, *SMALL_STIMULI, "trials=2"),
}


def failing() -> None:
    raise OSError("disk full")


@pytest.mark.parametrize("case", CASES)
def test_the_work_sees_the_whole_state_of_its_moment(case: str) -> None:
    simulation, engine = make_simulation(*CASES[case]), make_engine("fused", "cpu", 1)
    with Beside(simulation) as recorded:
        simulation.run(engine, 20)
        gone_on, seen = threading.Event(), {}

        def look() -> None:
            gone_on.wait(60)
            seen.update({key: values.clone() for key, values in recorded.copy.state_dict().items()})

        expected = {key: values.clone() for key, values in simulation.state_dict().items()}
        recorded.begin(look)
        simulation.run(engine, 20)
        gone_on.set()
        recorded.wait()
    assert seen.keys() == expected.keys()
    assert all(torch.equal(seen[key], expected[key]) for key in expected)
    assert not torch.equal(simulation.network.neurons.v, recorded.copy.network.neurons.v)


@pytest.mark.parametrize("then", [lambda recorded: recorded.wait(), lambda recorded: recorded.begin(print)])
def test_what_goes_wrong_in_the_work_is_raised_at_the_next_chance_and_once(then: Callable[[Beside], None]) -> None:
    with Beside(make_simulation("+experiment=food_attraction", "trials=1")) as recorded:
        recorded.begin(failing)
        with pytest.raises(OSError, match="disk full"):
            then(recorded)
        recorded.wait()


def test_a_large_state_is_not_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "LARGEST", 1000)
    simulation = make_simulation("+experiment=food_attraction", "trials=1")
    with Beside(simulation) as recorded:
        assert recorded.copy is simulation
        done = []
        recorded.begin(lambda: done.append(threading.current_thread()))
        assert done == [threading.main_thread()]
