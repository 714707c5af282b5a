"""How extinction is measured."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers import compose_config

from snnrl.beyond import extinction
from snnrl.beyond.extinction import AROUND, AT, DELAY, LENGTH, answer, dip, evoked
from snnrl.configuration.builder import build


def test_an_answer_counts_spikes_beyond_the_tonic_ones() -> None:
    response = torch.full((LENGTH, 2), 0.004)
    response[AT + 2, 1] = 0.75
    torch.testing.assert_close(answer(response, AT), torch.tensor([0.0, 0.746]))
    torch.testing.assert_close(answer(response, AT + DELAY), torch.zeros(2), atol=1e-6, rtol=0)


def test_a_dip_is_the_part_of_the_tonic_rate_that_is_missing() -> None:
    response = torch.full((LENGTH, 1), 0.004)
    response[AROUND] = 0.001
    torch.testing.assert_close(dip(response), torch.tensor([-0.75]))


def test_what_a_touch_would_evoke_is_measured_on_a_copy() -> None:
    config = compose_config("+experiment=extinction", "+robot.weights.food_container_dopamine=4", "trials=2")
    network = build(config).network
    before = {name: value.clone() for name, value in network.state_dict().items()}
    assert float(evoked(network).min()) > 0.3
    assert all(torch.equal(value, before[name]) for name, value in network.state_dict().items())
    network.projections["food_container_touch_to_dopaminergic"].weight.zero_()
    assert evoked(network).tolist() == [0.0, 0.0]


def test_periods_end_when_food_goes_and_when_it_comes_back() -> None:
    parts = extinction.periods({"time": np.arange(1.0, 36.0)}, 15.0, 25.0)
    ends = {name: (part.nonzero()[0][0] + 1, part.nonzero()[0][-1] + 1) for name, part in parts.items()}
    assert ends == {"with food": (13, 15), "without": (24, 25), "food again": (34, 35)}


def test_what_is_left_is_counted_beyond_what_a_robot_has_that_was_never_fed() -> None:
    time = np.arange(1.0, 36.0)
    course = np.select([time <= 15, time <= 25], [1.2, 0.3], 0.9)[:, None] * [1.0, 1.0, 0.2] + [0.0, 0.2, 0.0]
    never = {"time": np.arange(1.0, 26.0)} | {name: np.full((25, 1), 0.2) for name in extinction.LEAST}
    fed = {"time": time} | dict.fromkeys(extinction.LEAST, course)
    first, *_ = extinction.lives_table({"robot": fed}, {"robot": never}, 15.0, 25.0).splitlines()[2:]
    cells = [cell.strip() for cell in first.strip("|").split("|")]
    # of three robots one has not learnt; of 1.0 and 1.2 more than the unfed have, 0.1 and 0.3 are left
    assert cells[2] == "0.20"
    assert [cell.split(" [")[0] for cell in cells[3:]] == ["2 of 3", "1.30", "0.40", "1.00", "1 of 2", "2 of 2"]


def test_all_is_measured_with_and_without_inhibition(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extinction, "SHOWN", 2)
    tables = extinction.make(("trials=2", "threads=1"), 0.02).table.split("\n\n")
    assert [len(table.splitlines()) - 2 for table in tables] == [2 * 5, 2 * 4, 3 * 3, 3 * 2]
