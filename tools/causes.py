"""Where the fused engine's time goes: what a trial-millisecond costs without one part of the work, part by part.

    python tools/causes.py [--trials 10] [--repeats 7] [--seconds 10] [--warm-up 200]

Every row but the first two is measured by compiling the kernel without that part, from the same state; robots then do
something else, so rows are to steer by and need not add up: one that does not move in its world, for one, sees less or
more. Neurons and draws are those of `tools/limit.py`. One thread, one table a robot, in ns a trial-millisecond.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from bench import ROBOTS, learnt
from limit import limit_of

from snnrl.engines.fused import coding, network
from snnrl.engines.fused.engine import FusedEngine, kernels
from snnrl.simulation import Simulation


def no_pair(t, s, w, trial, now, power, through):  # type: ignore[no-untyped-def]
    pass


def no_send(t, s, w, trial, now, slots, through):  # type: ignore[no-untyped-def]
    pass


def no_settle(t, s, w, trial, power):  # type: ignore[no-untyped-def]
    w.drive[:] = 0.0
    w.reach[0] = 1e30


def no_modulators(t, w, now, found, sign, reward):  # type: ignore[no-untyped-def]
    pass


def no_world(world, seed, number, trial, left, right, now, touched):  # type: ignore[no-untyped-def]
    touched[:] = 0


PARTS: dict[str, tuple[tuple[Any, str, Callable[..., Any]], ...]] = {
    "pairing": ((network, "pair", no_pair),),
    "sending": ((network, "send", no_send),),
    "settling, homeostasis": ((network, "settle", no_settle),),
    "modulators": ((network, "step_modulators", no_modulators),),
    "world": ((coding, "step_world", no_world),),
}


@contextmanager
def without(part: str) -> Iterator[None]:
    """Compile kernels without a part of the work."""
    replaced = [(module, name, getattr(module, name)) for module, name, _ in PARTS.get(part, ())]
    kernels.cache_clear()
    try:
        for module, name, nothing in PARTS.get(part, ()):
            setattr(module, name, nothing)
        yield
    finally:
        for module, name, old in replaced:
            setattr(module, name, old)
        kernels.cache_clear()


def cost(simulation: Simulation[Any], seconds: float, repeats: int) -> float:
    """ns a trial-ms, the best of several runs from the same state."""
    engine, ticks, times = FusedEngine(1), round(1000 * seconds / simulation.tick), []
    for _ in range(repeats):
        fresh = copy.deepcopy(simulation)
        fresh.run(engine, 1)
        started = time.perf_counter()
        fresh.run(engine, ticks)
        times.append(time.perf_counter() - started)
    return 1e9 * min(times) / (ticks * simulation.tick * simulation.trials)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--warm-up", type=float, default=200.0)
    arguments = parser.parse_args()
    for robot in ROBOTS:
        simulation = learnt(robot, arguments.trials, arguments.warm_up)
        measured = {}
        for part in ("", *PARTS):
            with without(part):
                measured[part] = cost(simulation, arguments.seconds, arguments.repeats)
        whole, limit = measured.pop(""), limit_of(simulation)
        rows = {"neurons": limit["neurons"], "draws": limit["draws"]}
        rows |= {part: whole - left for part, left in measured.items()}
        rows["the rest: coding and sensing, finding spikes, calls"] = whole - sum(rows.values())
        print(f"{robot}: {whole:.0f} ns, {100 * (limit['neurons'] + limit['draws']) / whole:.0f} % of the limit")
        for part, value in rows.items():
            print(f"  {value:6.1f}  {100 * value / whole:4.0f} %  {part}")


if __name__ == "__main__":
    main()
