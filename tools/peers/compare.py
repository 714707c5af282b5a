"""The same brain, input and machine in other simulators: speed and deviations, side by side.

    python tools/peers/compare.py [--trials 1,50] [--seconds 1] [--threads 1,0] [--longest 60]
                                   [--markdown docs/peers.md]

The food-only brain is driven open loop by currents that its own closed loop recorded. Every simulator computes the
same milliseconds in float64 and keeps all spikes. They take turns, each in a process of its own, where no library of
another slows or crashes it; the quickest turn is shown. A wall time is that of the simulation alone: building the
network and compiling are not in it. The first line of a case is no simulator: what our neurons and random numbers cost
alone (`tools/limit.py`).
"""

from __future__ import annotations

import argparse
import copy
import os
import platform
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from dense_peer import DenseNetwork
from recording import Run, food_only, robots
from torch import Tensor

from snnrl.engines import make_engine
from snnrl.files import write
from snnrl.model.network import Network

sys.path.append(str(Path(__file__).parents[1]))
from limit import limit_of  # of the tools beside this folder

LEARNT = ("+robot.weights.food_attraction=3", "+robot.weights.food_avoidance=0.5")  # mV; about what it learns
SHORTEST, MOST = 0.3, 20  # s of wall time; what is faster is run again from the same state, so many times at most
DIED = "crashed, or ran out of memory"
LONG = 5.0  # s of wall time, of which warming up is no part to speak of
LEFT_OUT = {
    "BindsNET": "its `MSTDPET` takes one reward a step from outside, the same for the whole batch, whose trials share "
    "their weights; pairs are not of nearest spikes.",
    "Norse": "has STDP steps, but neither a lasting eligibility nor a modulator.",
    "snnTorch": "learns by gradients; its STDP learner has neither a lasting eligibility nor a modulator.",
    "PyGeNN": "its user-defined synapses may express the rule; the Python package index has no release of it.",
}


@dataclass
class Case:
    """What a simulator is given: a network at ms 0, its input [T, B, N] and how many threads it may use."""

    network: Network
    injected: Tensor
    threads: int
    folder: Path


@dataclass
class Row:
    """One line of the table; `note` says why there are no numbers, and without `spikes` it is not of a simulator."""

    peer: str
    trials: int
    threads: int
    walls: Sequence[float] = ()
    spikes: int | None = None
    mismatches: int = 0
    deviation: float = 0.0
    note: str = ""


def spikes_of(raster: Tensor) -> np.ndarray:
    """[n, 2] (ms, trial * N + neuron) of a raster [T, B, N]."""
    return raster.flatten(1).nonzero().numpy()


def ours(engine: str, dtype: torch.dtype) -> Callable[[Case], Callable[[], Run]]:
    """One of our engines."""

    def prepare(case: Case) -> Callable[[], Run]:
        start, injected = copy.deepcopy(case.network).to(dtype), case.injected.to(dtype)
        machine = make_engine(engine, "cpu", case.threads)
        raster = torch.zeros(injected.shape, dtype=torch.bool)

        def run() -> Run:
            network = copy.deepcopy(start)
            machine.run_network(network, injected[:0])  # lays out the topology, or compiles
            began = time.perf_counter()
            machine.run_network(network, injected, None, raster)
            wall = time.perf_counter() - began
            weight = network.synapses.weight[: network.synapses.plastic]
            return Run(wall, spikes_of(raster), weight.double().numpy())

        return run

    return prepare


def dense(case: Case) -> Callable[[], Run]:
    """Dense matrices in eager PyTorch."""
    background = case.network.background(torch.arange(len(case.injected)))

    def run() -> Run:
        network = DenseNetwork(case.network)
        raster = torch.zeros(case.injected.shape, dtype=torch.bool)
        began = time.perf_counter()
        for k in range(len(raster)):
            raster[k] = network.step(background[k] + case.injected[k])
        wall = time.perf_counter() - began
        return Run(wall, spikes_of(raster), network.weight[network.at_plastic].numpy())

    return run


def brian(mode: str) -> Callable[[Case], Callable[[], Run]]:
    """Brian2 in one of its modes: standalone, cython or numpy."""

    def prepare(case: Case) -> Callable[[], Run]:
        import brian_peer

        if mode == "standalone":
            return brian_peer.standalone(case.network, case.injected, case.threads, case.folder)
        return brian_peer.runtime(case.network, case.injected, mode)

    return prepare


def annarchy(case: Case) -> Callable[[], Run]:
    """ANNarchy, compiled with OpenMP."""
    import annarchy_peer

    return annarchy_peer.openmp(case.network, case.injected, case.threads, case.folder)


def nest(case: Case) -> Callable[[], Run]:
    """NEST, with the rule that it has."""
    import nest_peer

    return nest_peer.kernel(case.network, case.injected, case.threads)


ready: list[Callable[[], Run]] = []  # in that process: its simulator


def make_ready(name: str, trials: int, threads: int, steps: int, brian_mode: str, folder: Path) -> None:
    torch.set_num_threads(threads)
    ready.append(peers_by_name(brian_mode)[name](Case(*food_only(trials, steps, *LEARNT), threads, folder)))


def turn() -> Run:
    """One run, or the mean of as many as it takes to be timed well; then the first, which warms up, does not count."""
    (run,) = ready
    first = run()
    if first.wall > LONG:
        return first
    walls: list[float] = []
    while not walls or (sum(walls) < SHORTEST and len(walls) < MOST):
        walls.append(run().wall)
    return Run(statistics.fmean(walls), first.spikes, first.weight)


def compare(trials: int, threads: int, steps: int, names: Sequence[str], brian_mode: str, repeats: int) -> list[Row]:
    """Simulators of these names on one case, each in a process of its own, taking turns; the first is ours."""
    done: dict[str, list[Run]] = {name: [] for name in names}
    crashed = set()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        given = trials, threads, steps, brian_mode
        processes = {
            name: stack.enter_context(
                ProcessPoolExecutor(1, get_context("spawn"), make_ready, (name, *given, Path(folder, str(k))))
            )
            for k, name in enumerate(names)
        }
        for _ in range(repeats):
            for name, process in processes.items():
                try:
                    done[name].append(process.submit(turn).result())
                except BrokenProcessPool:
                    crashed.add(name)
    expected = done[names[0]][0]
    return [limit(trials, threads, steps)] + [
        Row(name, trials, threads, note=DIED) if name in crashed else row_of(name, trials, threads, runs, expected)
        for name, runs in done.items()
    ]


def row_of(name: str, trials: int, threads: int, runs: Sequence[Run], expected: Run) -> Row:
    """A simulator's runs, and how the first of them differs from what is expected."""
    ours, theirs = ({tuple(spike) for spike in run.spikes.tolist()} for run in (expected, runs[0]))
    deviation = float(np.abs(runs[0].weight - expected.weight).max())
    return Row(name, trials, threads, [run.wall for run in runs], len(theirs), len(ours ^ theirs), deviation)


def limit(trials: int, threads: int, steps: int) -> Row:
    """What our neurons and draws cost alone, on as many processors as trials can be on."""
    found = limit_of(robots(1, *LEARNT), threads=min(trials, threads))["trial_ms_per_s"]
    return Row("neurons and draws alone", trials, threads, [steps * trials / found])


def table(rows: Sequence[Row], steps: int) -> list[str]:
    """Lines of Markdown; the ratio is ours over theirs in speed, ours being the first of the same case."""
    lines = [
        "| trials | threads | simulator | wall, s (min to max) | trial-ms/s | ours is faster by | spikes | spikes that "
        "differ | largest difference of a weight, mV |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    ours: dict[tuple[int, int], float] = {}
    for row in rows:
        if row.spikes is not None and row.walls:
            ours.setdefault((row.trials, row.threads), min(row.walls))
    for row in rows:
        head = f"| {row.trials} | {row.threads} | {row.peer} |"
        if row.note:
            lines.append(f"{head} {row.note} | | | | | |")
            continue
        wall = min(row.walls)
        head += f" {wall:.3g} ({wall:.3g} to {max(row.walls):.3g}) | {steps * row.trials / wall:,.0f} |"
        head += f" {wall / ours[row.trials, row.threads]:.3g} |"
        found = f"{row.spikes} | {row.mismatches} | {row.deviation:.1e}" if row.spikes is not None else "| |"
        lines.append(f"{head} {found} |")
    return lines


def document(rows: Sequence[Row], steps: int, repeats: int, command: str) -> str:
    """The whole page."""
    packages = ("snnrl", "torch", "numpy", "numba", "brian2", "annarchy", "nest-simulator")
    names = ("snnrl", "torch", "numpy", "numba", "brian2", "ANNarchy", "nest")
    versions = ", ".join(
        f"{package} {version(package)}" if find_spec(name) else f"{package} not installed"
        for package, name in zip(packages, names, strict=True)
    )
    lines = [
        "# Peers, side by side",
        "",
        f"`{command}` wrote this page on {processor()}, {len(os.sched_getaffinity(0))} processors, "
        f"Python {platform.python_version()}: {versions}.",
        "",
        f"The food-only brain (160 neurons, about 1360 plastic synapses a trial), {steps} ms a trial, open loop with "
        "the currents that its own closed loop gave it; float64 unless a name says otherwise. All record all spikes. "
        "A wall time is that of the simulation alone, without building and compiling; it is the quickest of "
        f"{repeats} turns. Differences are from the first simulator of the same trials and threads. The dense and the "
        "other simulators' networks get the background noise as a table, ours draw it.",
        "",
        *table(rows, steps),
        "",
        "- *Neurons and draws alone* is what `tools/limit.py` measures: our neurons, in vectors, and their random "
        "numbers, without a spike, a synapse or a world. It bounds what a ratio can be on this machine.",
        "- *snnrl, reference* is plain eager PyTorch over flat lists of synapses, batched over trials: the "
        "specification that the fused engine is tested against.",
        "- *PyTorch, eager, dense* (`tools/peers/dense_peer.py`) is what one would write first: matrices of all "
        "pairs of neurons, batched over trials.",
        "- *Brian2* (`tools/peers/brian_peer.py`) is the network that the conformance tests hold equal to ours to "
        "1e-9, with all trials in one network and Brian2's own compiler options, among them `-ffast-math` in its C++ "
        "programs; in one thread it is built without OpenMP.",
        "- *ANNarchy* (`tools/peers/annarchy_peer.py`) has no equations for homeostasis, which is left out for it, and "
        "handles a presynaptic spike 1 ms after it was fired: so near as a hand can bring it, not the same.",
        "- *NEST* (`tools/peers/nest_peer.py`) has `stdp_dopamine_synapse`, which pairs a spike with all earlier ones, "
        "counts every dopaminergic spike and has no homeostasis: the same neurons and synapses, and another rule. What "
        "the two rules share is compared in [conformance.md](conformance.md).",
        "- One trial is never shared between threads by the fused engine.",
        "",
        "Left out:",
        "",
        *(f"- **{name}**: {reason}" for name, reason in LEFT_OUT.items()),
        "",
    ]
    return "\n".join(lines)


def processor() -> str:
    """The processor's name, where the machine tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def best_mode() -> str:
    """Brian2's fastest mode that this machine can compile for."""
    return "standalone" if shutil.which("g++") and shutil.which("make") else "numpy"


def peers_by_name(brian_mode: str) -> dict[str, Callable[[Case], Callable[[], Run]]]:
    """Ours, and those that are installed."""
    peers = {
        "snnrl, fused": ours("fused", torch.float64),
        "snnrl, fused, float32": ours("fused", torch.float32),
        "snnrl, reference": ours("reference", torch.float64),
        "PyTorch, eager, dense": dense,
    }
    if find_spec("brian2"):
        peers[f"Brian2, {brian_mode}"] = brian(brian_mode)
    if find_spec("ANNarchy"):
        peers["ANNarchy, OpenMP"] = annarchy
    if find_spec("nest"):
        peers["NEST, its own rule"] = nest
    return peers


def numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=numbers, default=[1, 50], help="of a batch, with commas between")
    parser.add_argument("--threads", type=numbers, default=[1, 0], help="0 is all")
    parser.add_argument("--seconds", type=float, default=1.0, help="simulated")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--longest", type=float, default=60.0, help="s a turn; who would take longer is left out")
    parser.add_argument("--brian", choices=("standalone", "cython", "numpy"), default=best_mode())
    parser.add_argument("--markdown", type=Path, help="file to write the table to")
    arguments = parser.parse_args()
    steps = max(1, round(1000 * arguments.seconds))
    processors = len(os.sched_getaffinity(0))
    names = list(peers_by_name(arguments.brian))
    rows: list[Row] = []
    for trials in arguments.trials:
        for threads in dict.fromkeys(count or processors for count in arguments.threads):
            seconds = {
                row.peer: trials * min(row.walls) / row.trials for row in rows if row.threads == threads and row.walls
            }
            slow = [name for name in names if seconds.get(name, 0.0) > arguments.longest]
            quick = [name for name in names if name not in slow]
            found = compare(trials, threads, steps, quick, arguments.brian, arguments.repeats)
            for name in slow:
                note = f"left out: at the pace of fewer trials {seconds[name]:.0f} s a turn"
                found.append(Row(name, trials, threads, note=note))
            if not find_spec("brian2"):
                found.append(Row("Brian2", trials, threads, note="not installed: `pip install 'snnrl[peers]'`"))
            print("\n".join(table(found, steps)[2 if rows else 0 :]), flush=True)
            rows += found
    if arguments.markdown:
        defaults = {action.dest: action.default for action in parser._actions}
        given = [
            f" --{key} {','.join(map(str, value)) if isinstance(value, list) else value}"
            for key, value in vars(arguments).items()
            if key == "markdown" or value != defaults[key]
        ]
        page = document(rows, steps, arguments.repeats, "python tools/peers/compare.py" + "".join(given))
        write(arguments.markdown, page)


if __name__ == "__main__":
    main()
