"""Whatever a configuration holds, it runs or is refused in one line; and nothing it names is executed."""

from __future__ import annotations

import ast
import copy
import os
import re
import resource
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import fuzz
import pytest
from helpers import compose_config
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import snnrl
from snnrl.configuration import footprint
from snnrl.configuration.builder import build
from snnrl.configuration.compose import conf_dir, plain
from snnrl.configuration.refusals import misfit
from snnrl.engines import make_engine
from snnrl.errors import ConfigError
from snnrl.running.command import LONGEST, explain
from snnrl.schema import Config

REFUSALS = (ConfigError, HydraException, OmegaConfBaseException)
CASES, PARTS = 2000, 8
LIMIT = 256 << 20  # bytes that a case may ask for
SECONDS = 300  # that no case takes, however slow the machine: a case may scale a tick, and run it on the reference


@contextmanager
def deadline(seconds: int) -> Iterator[None]:
    def late(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def composed(tree: fuzz.Tree) -> Config:
    """The configuration that the tree would make as a file."""
    if found := misfit(Config, tree):
        raise found
    merged = OmegaConf.merge(OmegaConf.structured(Config), tree)
    assert isinstance(merged, DictConfig)
    return plain(merged)


def outcome(tree: fuzz.Tree, engine: str) -> str:
    """What two ticks of it come to: "ran", or "refused" if that takes one printable line."""
    try:
        config = composed(tree)
        simulation = build(config)
        engine = engine if config.engine == "fused" else config.engine
        simulation.run(make_engine(engine, config.device, config.threads), 2)
    except REFUSALS as error:
        line = explain(error)
        assert line.isprintable()
        assert 10 < len(line) <= LONGEST + 5
        return "refused"
    return "ran"


def peak() -> int:
    """Most bytes of memory that this process has had."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """The fused engine, before any case is timed."""
    assert outcome(copy.deepcopy(fuzz.VALID), "fused") == "ran"


@pytest.mark.parametrize("part", range(PARTS))
def test_a_spoilt_configuration_runs_or_is_refused_in_one_line(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(footprint, "available", lambda: LIMIT)
    before, outcomes = peak(), Counter[str]()
    for seed in range(part * CASES // PARTS, (part + 1) * CASES // PARTS):
        how, tree = fuzz.case(seed)
        try:
            with deadline(SECONDS):
                outcomes[outcome(tree, "fused" if seed % 10 == 0 else "reference")] += 1
        except Exception as error:
            raise AssertionError(f"case {seed}: {how!a}") from error
    print(f"part {part}: {outcomes['ran']} ran, {outcomes['refused']} were refused in one line")
    assert outcomes["ran"] > CASES / PARTS / 10
    assert outcomes["refused"] > CASES / PARTS / 3
    assert peak() - before < 2 * LIMIT


def test_the_unspoilt_configuration_runs() -> None:
    assert outcome(fuzz.VALID, "fused") == "ran"


# names are the user's
FREE = {("network", kind) for kind in ("neurons", "synapses", "groups", "projections")} | {("world", "kinds")}


@pytest.mark.parametrize(
    "path",
    [path for path in fuzz.paths(fuzz.VALID) if isinstance(path[-1], str) and path[:-1] not in FREE],
    ids=".".join,
)
def test_no_misspelt_key_is_ignored(path: tuple[str, ...]) -> None:
    spoilt = copy.deepcopy(fuzz.VALID)
    holder = fuzz.parent(spoilt, path)
    holder[f"{path[-1]}x"] = copy.deepcopy(holder[path[-1]])
    with pytest.raises(REFUSALS):
        build(composed(spoilt))


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        (["network.groups.left_food.size=1000000"], "network.projections.left_food_to"),
        (["trials=10000000"], "network.projections."),
        (["world.kinds.food.count=100000", "trials=100000"], "world.kinds.food.count"),
        (["network.plasticity.tau_plus=1e12"], "network.plasticity.tau_plus"),
        (["seconds=1e9", "record.every=0.07", "trials=10"], "record.every"),
        (["engine=reference", "coding.tick=10000", "trials=1000"], "coding.tick"),
    ],
)
def test_more_memory_than_there_is_is_refused_before_it_is_taken(
    overrides: list[str], key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(footprint, "available", lambda: 8 << 30)
    config = compose_config("+experiment=food_attraction", *overrides)
    before = peak()
    with pytest.raises(ConfigError, match=rf"^{re.escape(key)}.*GiB of memory in all, must be at most 8 GiB$"):
        build(config)
    assert peak() - before < 64 << 20


MEASURE = """
import torch
from snnrl import Draws, build_network, make_engine, schema
from snnrl.configuration import footprint
def build(size):
    network = schema.NetworkConfig(
        neurons={"regular": schema.NeuronConfig(0.02, 0.2, -65.0, 8.0, v=-65.0)},
        synapses={"all": schema.SynapseConfig(1.0, plastic=True)},
        groups={"one": schema.GroupConfig(size, "regular"), "two": schema.GroupConfig(size, "regular")},
        projections={k: schema.ProjectionConfig(k, l, "all") for k, l in (("one", "two"), ("two", "one"))},
        synaptic_gain=1.0,
        plasticity=schema.PlasticityConfig(0.1, 0.1, 20.0, 20.0, 400.0, 4.0),
        dopamine=schema.ModulatorConfig("one", 0.0, 20.0, 0.01, 1, 0),
    )
    built = build_network(network, Draws(0, torch.arange(1)), torch.float64)
    make_engine("fused", "cpu", 1).run_network(built, torch.zeros(2, 1, 2 * size, dtype=torch.float64))
    return built, network
def peak():
    return 1024 * int(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
kept = build(3)
open("/proc/self/clear_refs", "w").write("5")  # the peak begins anew; a child's would begin with its parent's
before = peak()
built, network = build(1000)
grown = peak() - before
print(grown / sum(footprint.of_network(network, 1).values()))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_estimate_of_memory_is_not_too_low_and_not_far_too_high() -> None:
    for _ in range(2):  # the first may compile, which takes more memory than the network
        done = subprocess.run([sys.executable, "-c", MEASURE], capture_output=True, text=True, timeout=300, check=True)
    assert 0.4 < float(done.stdout) < 1.0


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("+experiment={outside}/own", "experiment=.*: must be a name inside the folder of configurations"),
        ("+experiment=../robot/learning", "experiment=../robot/learning: must be a name inside"),
        ("+experiment=../../etc/passwd", "experiment=../../etc/passwd: must be one of"),
        ("+experiment=/etc/passwd", "experiment=/etc/passwd: must be one of"),
        ("+hydra.callbacks.x._target_=os.system", "hydra.callbacks.x._target_=os.system: must begin with hydra"),
        ("hydra.launcher._target_=os.system", "hydra.launcher._target_=os.system: must begin with hydra"),
        ("hydra.job_logging.handlers.console.class=os.system", "class=os.system: must begin with logging"),
        ("+robot._target_=os.system", "_target_"),
        ("+network.groups.left_food._target_=os.system", "_target_"),
    ],
)
def test_a_configuration_reaches_nothing_outside(override: str, message: str, tmp_path: Path) -> None:
    text = "# @package _global_\nexperiment: {name: own, robots: [learning]}\ntrials: 1\nseconds: 0.7\n"
    (tmp_path / "own.yaml").write_text(text)
    outside = os.path.relpath(tmp_path, Path(conf_dir(), "experiment"))
    experiment = [] if "+experiment" in override else ["+experiment=food_attraction"]
    with pytest.raises(REFUSALS, match=message):
        build(compose_config(*experiment, override.format(outside=outside)))


def test_a_file_that_is_nested_too_deeply_is_refused(tmp_path: Path) -> None:
    (tmp_path / "experiment").mkdir()
    deep = "{a: " * 150 + "1" + "}" * 150
    (tmp_path / "experiment" / "deep.yaml").write_text(f"# @package _global_\nexperiment:\n  correct: {deep}\n")
    with pytest.raises(REFUSALS) as caught:
        build(compose_config(f"hydra.searchpath=[file://{tmp_path}]", "+experiment=deep"))
    assert len(explain(caught.value)) <= LONGEST + 5


def test_the_package_executes_nothing_that_it_reads() -> None:
    forbidden = {"eval", "exec", "compile", "__import__", "pickle", "marshal", "shelve", "instantiate", "unsafe_load"}
    for path in Path(snnrl.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module == "pickle":
                names = {alias.name for alias in node.names} - {"UnpicklingError"}  # to be caught
                assert not names, path
            elif isinstance(node, ast.ImportFrom):
                names = {str(node.module), *(alias.name for alias in node.names)}
            elif isinstance(node, ast.Call):
                called = node.func
                names = {getattr(called, "id", "") or getattr(called, "attr", "")}
                names -= {"compile"} if isinstance(called, ast.Attribute) else set()
            else:
                continue
            if path.name == "compiler.py":
                names -= {"exec"}  # of a source that is put together from the kernels' own texts and names of arguments
            assert not names & forbidden, (path, names & forbidden)
