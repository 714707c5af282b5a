"""The tools that measure, at sizes where they measure nothing."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import causes
import numpy as np
import pytest
import torch
from dense_peer import DenseNetwork
from helpers import compose_config
from recording import food_only
from scale import Cost, Size, checks, draw, sizes

from snnrl.configuration.builder import build
from snnrl.engines import make_engine

ROOT = Path(__file__).parents[1]
LEARNT = ("+robot.weights.food_attraction=3", "network.homeostasis.limit=1.2")


def run_tool(*arguments: str) -> str:
    command = [sys.executable, "-W", "ignore", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def rows_of(text: str) -> list[list[str]]:
    """Cells of the tables in a Markdown text, without heads and rules."""
    lines = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    return [
        [cell.strip() for cell in line] for line in lines if re.fullmatch(r"\d+|trials|hours|synapses", line[0].strip())
    ]


OTHERWISE = ("NEST, its own rule", "ANNarchy, OpenMP")  # another rule, or not the same to the ms


def test_peers_agree_and_are_timed(tmp_path: Path) -> None:
    small = ["--trials", "2", "--threads", "1", "--seconds", "0.05", "--repeats", "1", "--brian", "numpy"]
    page = tmp_path / "peers.md"
    printed = run_tool("tools/peers/compare.py", *small, "--markdown", str(page))
    rows = {row[2]: row[3:] for row in rows_of(page.read_text()) if row[0] == "2"}
    assert len(rows) == 6 + bool(find_spec("nest")) + bool(find_spec("ANNarchy"))
    for name, (_, speed, ratio, spikes, mismatches, deviation) in rows.items():
        if name == "Brian2" and find_spec("brian2") is None:
            continue
        assert float(speed.replace(",", "")) > 0
        assert float(ratio) > 0
        if name == "neurons and draws alone":
            assert float(ratio) < 1
            assert spikes == ""
            continue
        assert int(spikes) > 20
        assert f"| {name} |" in printed
        if name in OTHERWISE:
            continue
        assert int(mismatches) == 0
        assert float(deviation) < (1e-4 if "float32" in name else 1e-9)
    if find_spec("brian2") is None:
        pytest.skip("Brian2 is not installed: its row says so; pip install 'snnrl[peers]'")
    assert "Brian2, numpy" in rows


def test_speed_and_the_cost_of_recording_are_measured() -> None:
    sizes = [
        "--trials",
        "2",
        "--repeats",
        "1",
        "--seconds",
        "0.1",
        "--warm-up",
        "0.1",
        "--recorded",
        "45",
        "--steps",
        "30",
    ]
    printed = [json.loads(line) for line in run_tool("tools/bench.py", *sizes).splitlines()]
    for robot in ("food_only", "food_container"):
        lines = [line for line in printed if line.get("robot") == robot]
        speeds = {line["engine"]: line["trial_ms_per_s"]["min"] for line in lines if "engine" in line}
        assert speeds.keys() == {"fused", "reference"}
        assert min(speeds.values()) > 0
        (share,) = (line["percent_of_limit"] for line in lines if "percent_of_limit" in line)
        assert 0 < share["min"] < 100
        (cost,) = (line["recording_percent_of_run"] for line in lines if "recording_percent_of_run" in line)
        assert cost["min"] == cost["median"] == cost["max"] < 100
    steps = {
        (line["environment"], line["at_once"], line["engine"]): line["steps_per_s"]["min"]
        for line in printed
        if "steps_per_s" in line
    }
    assert len(steps) == 8
    assert min(steps.values()) > 0


def test_a_cause_is_left_out_and_put_back() -> None:
    """Without pairs of spikes nothing is eligible; afterwards the engine is what it was."""
    eligible = []
    for part in ("pairing", ""):
        simulation = build(compose_config("+experiment=food_attraction", "trials=1", *LEARNT))
        with causes.without(part):
            simulation.run(make_engine("fused", "cpu", 1), 40)
        assert (simulation.network.spike_count > 0).any()
        eligible.append(bool((simulation.network.synapses.eligibility != 0).any()))
    assert eligible == [False, True]


def test_the_dense_network_is_ours() -> None:
    network, injected = food_only(3, 400, *LEARNT)
    dense, background = DenseNetwork(network), network.background(torch.arange(len(injected)))
    expected = torch.stack([dense.step(background[k] + injected[k]) for k in range(len(injected))])
    before = network.synapses.weight[: network.synapses.plastic].clone()
    raster = torch.zeros_like(expected)
    make_engine("fused", "cpu", 1).run_network(network, injected, None, raster)
    weight = network.synapses.weight[: network.synapses.plastic]
    assert raster.equal(expected)
    assert (before - weight).max() > 0.1  # one step of homeostasis at least
    np.testing.assert_allclose(dense.weight[dense.at_plastic], weight, rtol=0, atol=1e-9)


def test_scale_writes_its_table_and_plot(tmp_path: Path) -> None:
    page = tmp_path / "scale.md"
    small = ["--trials", "2", "--hours", "0.01", "--synapses", "2000", "--seconds", "0.7", "--threads", "1"]
    printed = run_tool("tools/scale.py", "--small", *small, "--markdown", str(page))
    rows = rows_of(page.read_text())
    assert [row[:3] for row in rows] == [["trials", "2", "0.7"], ["hours", "2", "36"], ["synapses", "4", "10.5"]]
    assert rows == rows_of(printed)
    assert 1200 < int(rows[0][3].replace(",", "")) < 1500
    assert 1800 < int(rows[2][3].replace(",", "")) < 2300
    for row in rows:
        start, peak = float(row[7]), float(row[8])
        assert 50 < start <= peak
    assert page.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def cost(size: Size) -> Cost:
    """What a run costs that is linear in trials, seconds and synapses."""
    amount = size.trials * size.seconds * size.group**2 / 1e5
    memory = size.trials * size.group**2 / 1e3
    return Cost(size, 1.0, amount, 300.0, 300.0 + memory, 0.3 * size.seconds / 3600.0, 3.4 * size.group**2)


PLAN = sizes([100, 1000], [1.0, 10.0], [1360, 100_000], 20.0)


def test_linear_growth_passes_every_check(tmp_path: Path) -> None:
    found = checks([cost(size) for size in PLAN])
    assert len(found) == 7
    assert all(holds for holds, _ in found), found
    draw([cost(size) for size in PLAN], tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("place", "change", "said"),
    [
        (1, {"wall": 1e3}, "trials 100 to 1000: 1e\\+03 s"),
        (1, {"peak": 9e4}, "trials 100 to 1000: .* MB more than at the start"),
        (3, {"wall": 1e5}, "hours 1 to 10: 1e\\+05 s"),
        (3, {"peak": 340.0}, "10 h instead of 1 h: .* MB more at the peak"),
        (3, {"events": 50.0}, "10 h: 50.00 MB of events"),
        (5, {"wall": 1e5}, "synapses 1360 to 100000: 1e\\+05 s"),
        (5, {"peak": 9e4}, "synapses 1360 to 100000: .* MB more than at the start"),
    ],
)
def test_what_grows_too_fast_fails_its_check(place: int, change: dict[str, float], said: str) -> None:
    costs = [cost(size) for size in PLAN]
    costs[place] = dataclasses.replace(costs[place], **change)  # type: ignore[arg-type]
    failed = [words for holds, words in checks(costs) if not holds]
    assert len(failed) == 1
    assert re.match(said, failed[0])
