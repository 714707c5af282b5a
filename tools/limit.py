"""What the neurons and the random numbers of a brain cost alone on this machine: the limit of any engine on it.

    python tools/limit.py [--seconds 20] [--repeats 7]

All neurons of one trial are updated in every ms, LANES at a time, and what a tick draws is drawn; no spike is looked
at, nothing is sent or learnt, and there is no world. One core, the brains of the thesis, in the network's precision.
Prints one JSON line a brain, in ns a trial-millisecond and in trial-milliseconds a second.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines.fused.compiler import Program
from snnrl.engines.fused.draws import fill_counts
from snnrl.engines.fused.engine import FusedEngine
from snnrl.engines.fused.neurons import draw_noise, step_cells, stepping
from snnrl.engines.fused.vectors import LANES, load, mask_bits
from snnrl.engines.layout import PLACE, SIZE
from snnrl.simulation import Simulation

BRAINS = {"food_only": "food_attraction", "food_container": "dual_learning"}


def update_alone(t, w, ms):  # type: ignore[no-untyped-def]
    """All neurons for so many ms; the sum of who fired, so that nothing can be left out."""
    found = 0
    for _ in range(ms):
        for b in range(t.places // LANES):
            at = b * LANES
            current = load(w.background, t.background_at[b])  # type: ignore[call-arg, var-annotated]
            fired, _ = step_cells(t.model_of[b], w.cells, at, t.places, current)
            found += mask_bits(fired) & 1
    return found


def draw_alone(t, w, group, thresholds, tick, ticks):  # type: ignore[no-untyped-def]
    """What so many ticks draw: the background noise, and the exploration of one motor group."""
    size, place = t.groups[group, SIZE], t.groups[group, PLACE]
    for k in range(ticks):
        draw_noise(t, w, 0, k * tick, tick)
        fill_counts(w.injected, place, t.places, size, t.seed, 1, 0, k * tick, tick, thresholds)


def best(work: Callable[[], Any], repeats: int) -> float:
    """Shortest time of several calls (s)."""
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def limit_of(simulation: Simulation[Any], seconds: float, repeats: int) -> dict[str, float]:
    """ns a trial-ms of the neurons and of the draws, on one core."""
    network, coding, engine = simulation.network, simulation.situation.coding, FusedEngine(1)
    simulation.run(engine, round(1000 * seconds / coding.tick))  # to a state of use
    bound, _ = engine.bind(network)
    work = bound.works[coding.tick][0]
    program = Program(network.pending.numpy().dtype.type, stepping(bound.functions))
    update, draw = program.kernel(update_alone), program.kernel(draw_alone)
    thresholds, ticks = coding.exploration_thresholds.numpy(), round(1000 * seconds / coding.tick)
    motor, ms = coding.motor_groups[0], ticks * coding.tick
    cells = np.copy(work.cells)

    def neurons() -> None:
        work.cells[:] = cells
        update(bound.tables, work, ms)

    def draws() -> None:
        draw(bound.tables, work, motor, thresholds, coding.tick, ticks)

    for part in (neurons, draws):
        part()
    return {"neurons": 1e9 * best(neurons, repeats) / ms, "draws": 1e9 * best(draws, repeats) / ms}


def limits(seconds: float = 20.0, repeats: int = 7) -> dict[str, dict[str, float]]:
    """By brain: ns a trial-ms, on one core."""
    return {
        name: limit_of(build(compose(f"+experiment={experiment}", "trials=1")), seconds, repeats)
        for name, experiment in BRAINS.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated, a measurement")
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    for name, parts in limits(arguments.seconds, arguments.repeats).items():
        total = sum(parts.values())
        rounded = {key: round(value, 1) for key, value in parts.items()}
        print(json.dumps({"brain": name, "ns_per_trial_ms": rounded, "trial_ms_per_s_and_core": round(1e9 / total)}))


if __name__ == "__main__":
    main()
