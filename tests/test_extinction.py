"""How extinction is measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from helpers import compose_config

from snnrl.beyond import extinction
from snnrl.beyond.extinction import AROUND, AT, CUE, DELAY, LENGTH, REWARD, answer, dip, evoked
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


def test_a_page_keeps_its_words_and_gets_new_tables(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"words\n\n{extinction.BEGIN}\nold\n{extinction.END}\n\nmore\n")
    extinction.put(page, "| new |\n")
    extinction.put(page, "| new |\n")
    assert (
        page.read_text()
        == f"words\n\n{extinction.BEGIN}\n\n| new |\n\n![The same as a figure](page.png)\n\n{extinction.END}\n\nmore\n"
    )
    assert {CUE, REWARD} <= set(compose_config("+experiment=extinction").network.groups)
