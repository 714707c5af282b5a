"""Speed of the closed loop, world included, after compilation: one JSON line a case.

    python tools/bench.py [--trials 50] [--threads 0] [--repeats 5] [--seconds 100] [--warm-up 200] [--recorded 5000]
                          [--steps 5000]
    python tools/bench.py --device cuda --trials 50 1000

The unit is trial-milliseconds per second; the engine is `fused` on the CPU, `cuda` on an NVIDIA GPU, each against the
reference there. Every case starts from the same state, that of a robot which has learnt for the warm-up, and engines
take turns, so that ratios hold when the machine's speed drifts. Each figure is also a share of what neurons and random
numbers alone would allow there, on as many processors at once (`tools/limit.py`; on a GPU `tools/gpu_limit.py`), in
the same turns; `tools/causes.py` says what the rest is spent on.
Then come Gymnasium environments, in steps of one environment per second, `--steps` of a batch, or a 25th of them where
the world is plain torch; one alone is that of `gymnasium.make`, with its wrappers. The last lines say what share of a
whole run of `--recorded` s its recording takes, without imports: at its defaults, and without pictures.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import platform
import statistics
import time
from collections.abc import Sequence
from contextlib import redirect_stderr
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
import torch
from limit import limit_of

import snnrl.environments  # noqa: F401  # which registers them
from snnrl.command.bench import REFERENCE_SECONDS, ROBOTS, learnt, speed
from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import Engine, make_engine
from snnrl.errors import ConfigError
from snnrl.files import write_json
from snnrl.running.job import simulate
from snnrl.running.loggers import loggers_of
from snnrl.running.signals import Signals
from snnrl.simulation import Simulation

ENVIRONMENTS = ("snnrl/FoodAttraction-v0", "snnrl/DualLearning-v0")
RECORDED = {"recording_percent_of_run": (), "recording_without_pictures_percent_of_run": ("record.pictures=0",)}
BATCHES = (1, 256)  # environments at once
SLOWER = 25  # times fewer steps of the reference


def recording(engine: Engine, device: str, robot: str, trials: int, seconds: float, *recorded: str) -> float:
    """Share of a run (%) that its recording takes: of two runs, with it and without it, one after the other."""
    without = ("record.tensorboard=false", f"record.every={seconds}", f"record.start={seconds}")
    torch.set_num_threads(1)  # as in every run on this engine
    spent = []
    with TemporaryDirectory() as parent, redirect_stderr(io.StringIO()):
        for name, options in (("with", recorded), ("without", without)):
            config = compose(
                f"+experiment={ROBOTS[robot]}", f"trials={trials}", f"seconds={seconds}", f"device={device}", *options
            )
            folder = Path(parent, name)
            folder.mkdir()
            write_json(folder / "summary.json", {"complete": False, "overrides": []})
            loggers = loggers_of(config.record)
            simulation, started = build(config), time.perf_counter()
            for _ in simulate(config, simulation, engine, folder, None, Signals(), loggers=loggers):
                pass
            spent.append(time.perf_counter() - started)
    return 100.0 * (spent[0] - spent[1]) / spent[0]


def steps_per_second(name: str, batch: int, engine: str, steps: int) -> float:
    """Of one environment alone, or of a batch all together."""
    options: dict[str, Any] = {"overrides": [f"engine={engine}"]}
    made: Any = gymnasium.make(name, **options) if batch == 1 else gymnasium.make_vec(name, num_envs=batch, **options)
    made.reset(seed=0)
    actions: list[Any] = [k if batch == 1 else np.full(batch, k) for k in range(3)]
    for k in range(4):  # the first are checked by Gymnasium, or compiled
        made.step(actions[k % 3])
    started = time.perf_counter()
    for k in range(steps):
        made.step(actions[k // 20 % 3])
    return batch * steps / (time.perf_counter() - started)


def environments(steps: int, repeats: int) -> None:
    """Print the speed of each environment, compiled and in torch, which take turns."""
    for name in ENVIRONMENTS:
        for batch in BATCHES:
            pairs = [
                (
                    steps_per_second(name, batch, "fused", steps),
                    steps_per_second(name, batch, "reference", max(1, steps // SLOWER)),
                )
                for _ in range(repeats)
            ]
            case = {"environment": name, "at_once": batch}
            for engine, speeds in zip(("fused", "reference"), zip(*pairs, strict=True), strict=True):
                print(json.dumps({**case, "engine": engine, "steps_per_s": summary_of(speeds)}), flush=True)
            ratio = statistics.median(quick / slow for quick, slow in pairs)
            print(json.dumps({**case, "fused_over_reference": round(ratio, 1)}), flush=True)


def limit_on(device: str, simulation: Simulation[Any], threads: int) -> float:
    """Trial-ms/s of neurons and random numbers alone."""
    if device == "cpu":
        return limit_of(simulation, threads=threads)["trial_ms_per_s"]
    import gpu_limit  # which needs numba-cuda

    return gpu_limit.limit_of(simulation)


def summary_of(values: Sequence[float], digits: int | None = None) -> dict[str, float]:
    found = {"median": statistics.median(values), "min": min(values), "max": max(values)}
    return {key: round(value, digits) for key, value in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, nargs="+", default=[1, 50])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=100.0)
    parser.add_argument("--warm-up", type=float, default=200.0)
    parser.add_argument("--recorded", type=float, default=5000.0)
    parser.add_argument("--steps", type=int, default=5000)
    arguments = parser.parse_args()
    try:
        engine = make_engine("auto", arguments.device, arguments.threads)
    except ConfigError as error:
        raise SystemExit(f"bench.py: {error}") from None
    reference = make_engine("reference", arguments.device)
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    for robot in ROBOTS:
        for trials in arguments.trials:
            simulation = learnt(robot, trials, arguments.warm_up, arguments.device)
            threads = min(trials, arguments.threads or os.cpu_count() or 1)
            rounds = []
            for _ in range(arguments.repeats):
                limit = limit_on(arguments.device, simulation, threads)
                fast, slow = (
                    speed(engine, simulation, arguments.seconds),
                    speed(reference, simulation, REFERENCE_SECONDS),
                )
                rounds.append((fast, slow, limit))
            case = {"robot": robot, "trials": trials, "threads": threads}
            speeds = list(zip(*rounds, strict=True))
            for name, values in zip((engine.name, "reference"), speeds, strict=False):
                print(json.dumps({**case, "engine": name, "trial_ms_per_s": summary_of(values)}), flush=True)
            ratio = statistics.median(one / other for one, other, _ in rounds)
            print(json.dumps({**case, f"{engine.name}_over_reference": round(ratio, 1)}), flush=True)
            shares = [100.0 * one / limit for one, _, limit in rounds]
            print(json.dumps({**case, "percent_of_limit": summary_of(shares, 1)}), flush=True)
    if arguments.device == "cpu":
        environments(arguments.steps, arguments.repeats)
    for robot in ROBOTS:
        for trials in arguments.trials:
            case = {"robot": robot, "trials": trials, "seconds": arguments.recorded}
            for name, options in RECORDED.items():
                shares = [
                    recording(engine, arguments.device, robot, trials, arguments.recorded, *options)
                    for _ in range(arguments.repeats)
                ]
                print(json.dumps({**case, name: summary_of(shares, 1)}), flush=True)
    machine = {"machine": platform.processor() or platform.machine(), "torch": torch.__version__}
    if arguments.device != "cpu":
        machine["gpu"] = torch.cuda.get_device_name(arguments.device)
    print(json.dumps(machine))


if __name__ == "__main__":
    main()
