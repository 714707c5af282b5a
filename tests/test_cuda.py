"""The CUDA engine against the reference, in numba's simulator, and its kernels compiled as far as no GPU is needed.

The simulator must be chosen before numba is imported, so each of its cases is this file as a process of its own.
"""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from helpers import compose_config, make_dopamine, make_group, make_network, make_projection
from test_engines import Faster, third_network
from test_extensions import network_of
from torch import Tensor

from snnrl import engines
from snnrl.configuration.builder import build
from snnrl.engines import make_engine
from snnrl.engines.watched import WatchedEngine
from snnrl.model.network import Network
from snnrl.model.plasticity import Plasticity
from snnrl.recording.monitors import record
from snnrl.schema import ConfigError
from snnrl.simulation import Simulation

if TYPE_CHECKING:
    from snnrl.engines.cuda import CudaEngine

FOOD_ONLY = ("+experiment=food_attraction", "world.side=65", "world.kinds.food.count=60")
FOOD_CONTAINER = (
    "+experiment=dual_learning",
    "world.side=150",
    "world.kinds.food_container.count=12",
    "world.kinds.empty_container.count=12",
    "world.kinds.food.count=10",
    "+robot.weights.container_attraction=3",
    "+robot.weights.food_attraction=3",
    "+robot.weights.food_avoidance=3",
    "network.homeostasis.limit=1.5",
)
POISON = (*FOOD_ONLY, "+robot.weights.food_attraction=2", "world.kinds.food.poison_from=0")


def simulation(*overrides: str) -> Simulation:
    return build(compose_config(*overrides, "trials=2", "seed=5"))


def assert_same(actual: torch.nn.Module, expected: torch.nn.Module, within: float = 0.0) -> None:
    """To the bit, or nearly."""
    for key, value in expected.state_dict().items():
        difference = (actual.state_dict()[key].double() - value.double()).abs()
        assert (difference <= within * (1.0 + value.double().abs())).all(), (key, difference.max())


def closed_loop(first: Simulation, ticks: int, device: str = "cpu") -> Simulation:
    """Run it on both engines; the same spikes, and afterwards the same state."""
    second = copy.deepcopy(first).to(device)
    raster = torch.zeros(ticks * first.tick, first.trials, first.network.size, dtype=torch.bool)
    other = torch.ones_like(raster).to(device)
    first.run(make_engine("reference", "cpu"), ticks, raster)
    second.run(make_engine("cuda", device), ticks, other)
    assert raster.any(2).any(0).all()
    assert torch.equal(other.cpu(), raster)
    assert_same(second.to("cpu"), first)
    return first


def open_loop(first: Network, steps: int, level: float, within: float, device: str = "cpu") -> None:
    """The same with given currents, signs and rewards."""
    second = copy.deepcopy(first).to(device)
    generator = torch.Generator().manual_seed(1)
    injected = level * torch.rand(steps, first.trials, first.size, generator=generator, dtype=first.dtype)
    sign = torch.tensor([1.0, -1.0, 1.0], dtype=first.dtype)[: first.trials]
    reward = torch.zeros(steps, first.trials, dtype=first.dtype)
    reward[20::30, 1] = 0.02
    raster = torch.zeros(injected.shape, dtype=torch.bool)
    other = torch.ones_like(raster).to(device)
    make_engine("reference", "cpu").run_network(first, injected, sign, raster, reward)
    make_engine("cuda", device).run_network(second, injected.to(device), sign.to(device), other, reward.to(device))
    assert all(raster[:, :, group.span].any() for group in first.groups.values())
    assert torch.equal(other.cpu(), raster)
    assert_same(second.to("cpu"), first, within)


def food_only() -> None:
    """In two launches."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("snnrl.engines.cuda.engine.TICKS", 2)
        run = closed_loop(simulation(*FOOD_ONLY, "dtype=float64"), 3)
    assert run.situation.world.touches.any()


def food_only_in_float32() -> None:
    closed_loop(simulation(*FOOD_ONLY), 1)


def poison() -> None:
    """Two ticks in which the second trial eats some, and its dopamine falls."""
    run = simulation(*POISON, "dtype=float64")
    run.run(make_engine("fused", "cpu", 1), 14)
    dopamine = run.network.dopamine
    assert dopamine is not None
    before = dopamine.total.clone()
    closed_loop(run, 2)
    assert (dopamine.total - before)[1] / (2 * run.tick) < -0.01


def food_container() -> None:
    """Three ticks in which a container is entered, food is taken from one, and sets are above their limit."""
    run = simulation(*FOOD_CONTAINER, "dtype=float64", "trial_start=10")
    run.run(make_engine("fused", "cpu", 1), 13)  # by which sets have come down to their limits
    raised = run.network.projections["left_food_to_left_motor"].weight
    raised += 1.0
    before, weights = run.situation.world.touches.clone(), raised.clone()
    closed_loop(run, 3)
    assert (run.situation.world.touches - before)[0].tolist() == [1, 0, 1]
    assert (raised < weights).all()


def free_readings() -> None:
    """Every kind of background, and exploration that is stronger and drawn once a tick."""
    noisy = ("gaussian=0.1", "kick=30", "kick_rate=20")
    options = ("coding.exploration_gain=1.45", "coding.exploration_drawn=each_tick")
    groups = [f"network.groups.dopaminergic.{value}" for value in noisy]
    closed_loop(simulation(*FOOD_ONLY, *groups, *options, "dtype=float64"), 2)


def without_winners() -> None:
    """Both eyes answer, by constant currents too, and wheels go by the motors' shares."""
    options = ("coding.wheels=share", "world.ranges.food.answers=both", "coding.range_current=6")
    closed_loop(simulation(*FOOD_ONLY, *options, "dtype=float64"), 3)


def off_chip() -> None:
    """A trial's synapses have no room in the memory of a block."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("snnrl.engines.cuda.engine.ON_CHIP", 0)
        closed_loop(simulation(*FOOD_ONLY, "dtype=float64"), 1)


def delays_and_loops() -> None:
    open_loop(third_network(3, 2, torch.float64), 100, 9.0, 0.0)


def functions_of_a_user(rule: str, within: float) -> None:
    network = network_of(rule, trials=2)
    before = network.synapses.weight.clone()
    open_loop(network, 90, 12.0, within)
    assert not torch.equal(network.synapses.weight, before)


def soft() -> None:
    functions_of_a_user("soft", 0.0)


def approaching() -> None:
    functions_of_a_user("approaching", 1e-9)  # by torch.exp, which is not the same bits everywhere


def depresses() -> None:
    functions_of_a_user("depresses", 0.0)


def turns() -> None:
    """Both engines, and parts of a run, follow each other on one simulation; only the first trial is shown."""
    first = simulation(*FOOD_ONLY, "dtype=float64")
    second = copy.deepcopy(first)
    reference, cuda = make_engine("reference", "cpu"), make_engine("cuda", "cpu")
    whole = torch.zeros(3 * first.tick, 2, first.network.size, dtype=torch.bool)
    shown = torch.zeros(first.tick, 1, first.network.size, dtype=torch.bool)
    first.run(reference, 3, whole)
    second.run(cuda, 1)
    second.run(reference, 1)
    second.run(cuda, 1, shown)
    assert torch.equal(shown, whole[2 * first.tick :, :1])
    assert_same(second, first)


def without_modulators() -> None:
    """A network of neurons and fixed synapses, and none that could learn."""
    weight = torch.full((2, 3, 5), 9.0, dtype=torch.float64)
    groups = [make_group("in", 3, 2, current=8.0), make_group("out", 5, 2)]
    first = make_network(groups, [make_projection("p", "in", "out", weight, plastic=False, delay=4)])
    second = copy.deepcopy(first)
    for engine, network in (("reference", first), ("cuda", second)):
        make_engine(engine, "cpu").run_network(network, torch.zeros(120, 2, 8, dtype=torch.float64))
    assert (first.spike_count > 0).all()
    assert_same(second, first)


def watched() -> None:
    """What a monitor sees, in the middle of a tick and with spikes; it changes nothing."""
    runs = [simulation(*FOOD_ONLY, "dtype=float64") for _ in range(3)]
    chosen = {"neurons": [3, 7], "trials": [1], "every": 30}
    first, second = (record(run.network, "left_food", ["v", "spikes"], **chosen) for run in runs[:2])
    runs[0].run(WatchedEngine(make_engine("reference", "cpu"), [first]), 1)
    runs[1].run(WatchedEngine(make_engine("cuda", "cpu"), [second]), 1)
    runs[2].run(make_engine("cuda", "cpu"), 1)
    assert first.time.tolist() == second.time.tolist() == [30, 60]
    np.testing.assert_array_equal(first["v"], second["v"])
    np.testing.assert_array_equal(first["spikes"], second["spikes"])
    assert_same(runs[1], runs[2])


def bent(weight: Tensor, change: Tensor) -> Tensor:
    return weight + torch.erf(change)


def neurons_alone() -> None:
    """What the limit of a GPU is measured with: they fire, and nothing is learnt."""
    from snnrl.engines.cuda import CudaEngine

    sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
    import gpu_limit

    run = simulation(*FOOD_ONLY, "dtype=float64")
    before, weights = run.network.neurons.last_spike.clone(), run.network.synapses.weight.clone()
    assert gpu_limit.limit_of(run, 0.07, 1) > 0.0
    assert torch.equal(run.network.neurons.last_spike, before)  # of a copy
    launch = CudaEngine().launch(run.network, 0, 0)
    coding = gpu_limit.coding_arrays(run.situation.coding, run.network, run.situation.world)
    launch(gpu_limit.all_alone, run.tick, coding, 1, np.zeros((0, 0, 0), np.uint8))
    assert (run.network.neurons.last_spike > before).any()
    assert torch.equal(run.network.synapses.weight, weights)


def refusals() -> None:
    cuda = make_engine("cuda", "cpu")
    changed = simulation(*FOOD_ONLY)
    changed.situation.world.__class__ = Faster
    with pytest.raises(ConfigError, match="engine=cuda: cannot run Faster; use engine=reference"):
        changed.run(cuda, 1)
    with pytest.raises(ConfigError, match=r"cannot run bent, which uses torch\.erf; use engine=reference"):
        cuda.run_network(*network_with_a_rule(bent))
    with pytest.raises(ConfigError, match="engine=cuda: runs on device=cpu only, not on device=cuda"):
        make_engine("cuda", "cuda")


def network_with_a_rule(rule: Callable[..., Tensor]) -> tuple[Network, Tensor]:
    """A network that learns by it, and no current for it."""
    groups = [make_group("pre", 1), make_group("post", 1), make_group("dopaminergic", 1)]
    weight = torch.full((1, 1, 1), 2.0, dtype=torch.float64)
    learns = Plasticity(0.1, 0.15, 20.0, 110.0, 476.0, 4.0, weight_rule=rule)
    network = make_network(groups, [make_projection("p", "pre", "post", weight, rule=learns)], make_dopamine())
    return network, torch.zeros(3, 1, 3, dtype=torch.float64)


CASES = (
    *(food_only, food_only_in_float32, poison, food_container, free_readings, without_winners),
    *(off_chip, delays_and_loops, soft, approaching, depresses),
    *(turns, without_modulators, watched, neurons_alone, refusals),
)


@pytest.fixture(scope="module")
def failures() -> dict[str, str]:
    """What went wrong, by case, of all cases in one process; "" of one that passed."""
    pytest.importorskip("numba_cuda")
    here = Path(__file__)
    done = subprocess.run(
        [sys.executable, str(here)],
        cwd=here.parents[1],
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", [case.__name__ for case in CASES])
def test_in_the_simulator(case: str, failures: dict[str, str]) -> None:
    assert failures[case] == ""


@pytest.fixture
def compiling(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[CudaEngine, dict[str, str]]]:
    """An engine that compiles for a GPU what it would launch, and the assembly by the name of the kernel."""
    pytest.importorskip("numba_cuda")
    from numba import cuda, typeof

    from snnrl.engines.cuda import engine

    assembly: dict[str, str] = {}

    def compile_only(kernel: Any, configuration: tuple[int, ...], given: tuple[Any, ...]) -> None:
        assert kernel.targetoptions["lto"] is False  # else linking optimises again, without what it is told here
        function, signature = kernel.py_func, tuple(map(typeof, given))
        assembly[function.__name__] = cuda.compile(function, signature, device=False, abi="numba", cc=(8, 0))[0]

    monkeypatch.setattr(cuda, "is_available", lambda: True)
    device = SimpleNamespace(compute_capability=(8, 0))
    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: device)
    monkeypatch.setattr("torch.cuda.synchronize", lambda device: None)
    monkeypatch.setattr(engine.CudaEngine, "_current", lambda self, network: nullcontext())
    monkeypatch.setattr(engine, "array_of", Tensor.numpy)
    monkeypatch.setattr(engine, "_start", compile_only)
    engine.program_of.cache_clear()
    yield engine.CudaEngine(), assembly
    engine.program_of.cache_clear()


def machine_code(assembly: str) -> bytes:
    """What NVIDIA's assembler makes of it: it knows limits on arguments, registers and names."""
    from cuda.core import Linker, LinkerOptions, ObjectCode

    return Linker(ObjectCode.from_ptx(assembly.encode()), options=LinkerOptions(arch="sm_80")).link("cubin").code


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("part", ["food-container", "functions of a user"])
def test_kernels_compile_for_a_gpu_and_keep_products_and_sums_apart(compiling: Any, dtype: str, part: str) -> None:
    engine, assembly = compiling
    run = simulation(*FOOD_CONTAINER, f"dtype={dtype}")
    networks = {"food-container": run.network, "functions of a user": network_of("soft", dtype=getattr(torch, dtype))}
    network = networks[part]
    if part == "food-container":
        engine.run(network, run.situation, 1)
    engine.run_network(network, torch.zeros(2, network.trials, network.size, dtype=network.dtype))
    assert set(assembly) == {"run_network"} | ({"run_robot"} if part == "food-container" else set())
    for text in assembly.values():
        assert ".entry" in text
        assert "fma." not in text
        assert ("mul.rn.f64" if dtype == "float64" else "mul.rn.f32") in text
        assert machine_code(text)


def test_by_itself_the_compiler_would_fuse_products_and_sums(compiling: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    engine, assembly = compiling
    monkeypatch.setattr("snnrl.engines.cuda.engine.compiling", nullcontext)
    engine.run_network(*network_with_a_rule(lambda weight, change: weight * weight + change))
    assert "fma." in assembly["run_network"]


def test_what_cannot_be_compiled_is_refused_in_one_line(compiling: Any) -> None:
    engine, _ = compiling
    message = r"^engine=cuda: cannot compile it \(Unknown attribute 'median' of type float64\); use engine=reference$"
    with pytest.raises(ConfigError, match=message):
        engine.run_network(*network_with_a_rule(lambda weight, change: weight.median()))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_a_run_ends_in_one_line(tmp_path: Path) -> None:
    pytest.importorskip("numba_cuda")
    command = [sys.executable, "-m", "snnrl.run", "+experiment=food_attraction", "engine=cuda", "trials=1"]
    command += ["seconds=0.7", f"hydra.run.dir={tmp_path}/out"]
    root = Path(__file__).parents[1]
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "0"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode != 0
    lines = done.stderr.strip().splitlines()
    assert lines == ["snnrl.run: engine=cuda: finds no NVIDIA GPU and its driver on this machine"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_its_speed_is_not_measured() -> None:
    pytest.importorskip("numba_cuda")
    root = Path(__file__).parents[1]
    command = [sys.executable, "tools/bench.py", "--device", "cuda"]
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "0"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode != 0
    assert done.stderr.splitlines() == ["bench.py: engine=cuda: finds no NVIDIA GPU and its driver on this machine"]


def test_spikes_are_sent_in_the_order_of_the_synapses() -> None:
    """Neuron by neuron in each phase, every synapse once; also where two projections join the same groups."""
    pytest.importorskip("numba_cuda")
    from snnrl.engines.cuda.work import wiring_of
    from snnrl.engines.layout import tables, topology

    groups = [make_group(name, 2) for name in ("a", "b", "c")]
    weight = torch.ones(1, 2, 2)
    ends = [("a", "c"), ("b", "c"), ("a", "c"), ("c", "a"), ("b", "a")]
    networks = [
        make_network(groups, [make_projection(str(k), *pair, weight) for k, pair in enumerate(ends)]),
        simulation(*FOOD_CONTAINER).network,
    ]
    for network, phases in zip(networks, (3, 2), strict=True):
        wiring = wiring_of(network, tables(network, topology(network, 1, lists=False), 1)[0])
        assert len(wiring.row_of) == phases
        for trial in range(network.trials):
            synapses = network.synapses
            for n in range(network.size):
                own = ((synapses.trial == trial) & (synapses.post == trial * network.size + n)).nonzero()[:, 0]
                rows = [row for phase in wiring.row_of for row in phase if row >= 0]
                places = [int(wiring.rows[trial, row, n]) - 1 for row in rows]
                assert [int(wiring.at[trial, place]) for place in places if place >= 0] == own.tolist()


def test_without_numba_cuda_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    message = r'^engine=cuda: needs numba-cuda: pip install "snnrl\[cuda\]"; or use engine=reference$'
    for name in ("cuda", "auto"):
        with pytest.raises(ConfigError, match=message):
            make_engine(name, "cuda")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU")
def test_on_a_gpu_the_spikes_are_the_references() -> None:
    run = simulation(*FOOD_CONTAINER, "dtype=float64")
    closed_loop(run, 72, "cuda")
    closed_loop(simulation(*FOOD_ONLY, "dtype=float64"), 72, "cuda")
    open_loop(third_network(3, 3, torch.float64), 2000, 4.0, 1e-9, "cuda")
    silent = [name for name, count in zip(run.network.groups, run.network.spike_count.sum(0), strict=True) if not count]
    assert silent == ["inhibitory"]


def main() -> None:
    """Run all cases and print what went wrong, as JSON."""
    sys.setswitchinterval(1e-4)  # the simulator's threads mostly wait for each other
    torch.set_num_threads(1)
    failures = dict.fromkeys((case.__name__ for case in CASES), "")
    for case in CASES:
        try:
            case()
        except Exception:
            failures[case.__name__] = traceback.format_exc()
    print(json.dumps(failures))


if __name__ == "__main__":
    main()
