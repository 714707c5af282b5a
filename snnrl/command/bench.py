"""`snnrl bench`: how fast robots that have learnt are simulated on this machine, world included, after compilation.

The unit is trial-milliseconds per second: one millisecond of one robot, its network and its world. Medians, least and
most of the repeats, and how many times as fast as plain torch that is. Engines take turns, so that the ratio holds
when the machine's speed drifts.
"""

from __future__ import annotations

import argparse
import copy
import statistics
import time
from collections.abc import Callable
from typing import Any

import torch

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines import Engine, make_engine
from snnrl.running.command import launch
from snnrl.running.schedule import ticks_of
from snnrl.simulation import Simulation

ROBOTS = {"food_only": "food_attraction", "food_container": "dual_learning"}
REFERENCE_SECONDS = 0.7  # simulated; the reference engine is slow


def learnt(robot: str, trials: int, warm_up: float, device: str = "cpu") -> Simulation[Any]:
    """A batch of robots that have learnt for `warm_up` simulated seconds, on the compiled engine of a device."""
    simulation = build(compose(f"+experiment={ROBOTS[robot]}", f"trials={trials}")).to(device)
    simulation.run(make_engine("auto", device), ticks_of(warm_up, simulation.tick))
    return simulation


def speed(engine: Engine, simulation: Simulation[Any], seconds: float) -> float:
    """Trial-milliseconds per second of one run from a copy of the state."""
    fresh = copy.deepcopy(simulation)
    fresh.run(engine, 1)
    count = ticks_of(seconds, fresh.tick)
    wait: Callable[[], None] = torch.cuda.synchronize if fresh.network.device.type == "cuda" else lambda: None
    wait()
    started = time.perf_counter()
    fresh.run(engine, count)
    wait()
    return fresh.trials * count * fresh.tick / (time.perf_counter() - started)


def measure(robot: str, options: argparse.Namespace) -> str:
    """One line about one robot.

    Raises:
        ConfigError: the engine cannot be had on the device.
    """
    quick = make_engine("auto", options.device, options.threads)
    slow = make_engine("reference", options.device)
    simulation = learnt(robot, options.trials, options.warm_up, options.device)
    pairs = [
        (speed(quick, simulation, options.seconds), speed(slow, simulation, REFERENCE_SECONDS))
        for _ in range(options.repeats)
    ]
    fast = [one for one, _ in pairs]
    ratio = statistics.median(one / other for one, other in pairs)
    return (
        f"{robot:<16}{quick.name:<8}{statistics.median(fast) / 1e6:8.2f} million trial-ms/s "
        f"({min(fast) / 1e6:.2f} to {max(fast) / 1e6:.2f}), {ratio:,.0f} times plain torch"
    )


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--trials", type=int, default=50, help="robots at once (default 50)")
    made.add_argument("--threads", type=int, default=0, help="0, the default, is one per processor")
    made.add_argument("--device", default="cpu", help="cpu, the default, or cuda")
    made.add_argument("--seconds", type=float, default=20.0, help="simulated, a measurement (default 20)")
    made.add_argument("--warm-up", type=float, default=200.0, help="simulated, for which they learn (default 200)")
    made.add_argument("--repeats", type=int, default=3, help="measurements (default 3)")
    return made


@torch.no_grad()
def main() -> None:
    options = parser().parse_args()

    def start() -> None:
        for robot in ROBOTS:
            print(measure(robot, options), flush=True)

    launch("snnrl bench", start)
