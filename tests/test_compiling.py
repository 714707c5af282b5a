"""Compiling comes before the first tick, is said when it happens, and is no part of a run's time."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import compose_config

from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.engines.fused import compiler
from snnrl.engines.fused.compiler import Program, placeholder
from snnrl.engines.fused.engine import FusedEngine, kernels
from snnrl.running import progress
from snnrl.running.progress import Progress
from snnrl.schema import Config

ROBOT = ("+experiment=food_attraction", "robot=random_walk", "trials=3")
TASK = ("+experiment=distal_reward", "trials=2")


@placeholder
def bounded(value: float) -> float:
    """What each program has its own for."""
    raise NotImplementedError


def doubled(value: float) -> float:
    return 2.0 * value


def both(value: float) -> float:
    return doubled(value) + bounded(value)


@compiler.rare
def halved(value: float) -> float:
    return bounded(value) / 2.0


def apart(value: float) -> float:
    return halved(value) + 10.0


def from_above(value: float) -> float:
    return min(value, 1.0)


def from_below(value: float) -> float:
    return max(value, 1.0)


def known(engine: FusedEngine, config: Config) -> int:
    """How many kinds of arguments the two kernels of a configuration's network have been compiled or loaded for."""
    bound = engine.bind(build(config).network)
    real: Any = np.float32
    return sum(len(kernel.signatures) for kernel in kernels(bound.functions, real))


def refuse() -> None:
    raise AssertionError("compiles again")


def test_programs_share_the_parts_that_are_the_same_in_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiler, "_PARTS", {})
    made, names = [], set()
    for real, rule in ((np.float64, from_above), (np.float64, from_below), (np.float32, from_above)):
        kernel = Program(real, {"bounded": rule}).kernel(both)
        made.append(({code.co_name: part for (code, *_), part in compiler._PARTS.items()}, kernel(3.0), kernel(0.5)))
        names.add(kernel.__name__)
    (first, *capped), (second, *floored), (third, *_) = made
    assert (capped, floored) == ([7.0, 1.5], [9.0, 2.0])
    assert first["doubled"] is second["doubled"]
    assert first["both"] is not second["both"]
    assert third["doubled"] is not first["doubled"]
    assert len(names) == 3  # by which a linker tells kernels apart


EACH = """
import sys
import numpy as np
from test_compiling import Program, apart, from_above, from_below

for rule in sys.argv[1:]:
    kernel = Program(np.float64, {"bounded": {"above": from_above, "below": from_below}[rule]}).kernel(apart)
    print(kernel(3.0), kernel(0.5))
"""


def test_kernels_that_other_processes_compiled_do_not_take_each_others_parts(tmp_path: Path) -> None:
    """Each was the first that its process compiled, so that parts which are not the same are called the same."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(Path(__file__).parent)}
    said = []
    for rules in (["above"], ["below"], ["above", "below"], ["below", "above"]):
        command = [sys.executable, "-c", EACH, *rules]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.splitlines())
    above, below = "10.5 10.25", "11.5 10.5"
    assert said == [[above], [below], [above, below], [below, above]]
    assert len(list(tmp_path.rglob("*.nbc"))) == 2


@pytest.mark.parametrize("options", [ROBOT, TASK], ids=["robot", "task"])
def test_after_it_is_prepared_a_run_compiles_nothing_and_is_as_it_was(options: tuple[str, ...]) -> None:
    config = compose_config(*options, "threads=1")
    simulation, engine = build(config), FusedEngine(1)
    before = {key: values.clone() for key, values in simulation.state_dict().items()}
    engine.prepare(simulation.network, simulation.situation, lambda: None)
    assert all(torch.equal(values, before[key]) for key, values in simulation.state_dict().items())
    prepared = known(engine, config)
    assert prepared > 0
    simulation.run(engine, 2)
    simulation.run(engine, 2, torch.zeros(2 * simulation.tick, 1, simulation.network.size, dtype=torch.bool))
    assert known(engine, config) == prepared
    engine.prepare(simulation.network, simulation.situation, refuse)


def test_the_reference_has_nothing_to_prepare() -> None:
    simulation = build(compose_config(*ROBOT))
    make_engine("reference", "cpu").prepare(simulation.network, simulation.situation, refuse)


def test_the_first_start_says_that_it_compiles_and_later_ones_do_not(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    options = [*ROBOT[:2], "trials=1", "seconds=0.7", "record.tensorboard=false"]
    said = []
    for folder in ("first", "second"):
        command = [sys.executable, "-m", "snnrl.run", *options, f"hydra.run.dir={tmp_path / folder}"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        said.append(done.stderr.splitlines())
    assert said[0][0] == "food_attraction random_walk  compiling, once"
    assert [len([line for line in lines if "compiling" in line]) for lines in said] == [1, 0]
    assert list((tmp_path / "cache" / "snnrl").rglob("*.nbc"))


def test_preparing_is_no_part_of_a_runs_time(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    shown = Progress("a run", 1, 10.0, wall=3.0)
    with shown.preparing():
        now[0] += 20.0
    now[0] += 2.0
    assert shown.wall == 5.0
    shown.show(5.0, lambda: "well")
    assert re.search(r"well .* 5 s left", capsys.readouterr().err)
