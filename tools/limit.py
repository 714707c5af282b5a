"""What the neurons and the random numbers of a brain cost alone on this machine: the limit of any engine on it.

    python tools/limit.py [--seconds 1000] [--repeats 7] [--threads 1]

All neurons of one trial are updated in every ms, LANES at a time, and what a tick draws is drawn; no spike is looked
at, nothing is sent or learnt, and there is no world. The brains of the thesis, in the network's precision. Prints one
JSON line a brain: ns a trial-millisecond on each of the threads, and trial-milliseconds a second of all of them. A
round takes a tenth of a second: in one of less than a millisecond, the threads' start makes the limit seem lower, by a
sixth on one thread and by up to two fifths on two.
"""

from __future__ import annotations

import argparse
import copy
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines.fused.compiler import Program
from snnrl.engines.fused.draws import fill_counts
from snnrl.engines.fused.engine import FusedEngine
from snnrl.engines.fused.neurons import draw_noise, step_cells, stepping
from snnrl.engines.fused.vectors import LANES, load, mask_bits
from snnrl.engines.layout import PLACE, SIZE
from snnrl.simulation import Simulation

SECONDS = 1000.0  # simulated, a round: about 0.1 s
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


def draw_alone(t, w, group, thresholds, gain, tick, ticks):  # type: ignore[no-untyped-def]
    """What so many ticks draw: the background noise, and the exploration of one motor group."""
    size, place = t.groups[group, SIZE], t.groups[group, PLACE]
    for k in range(ticks):
        draw_noise(t, w, 0, k * tick, tick)
        fill_counts(w.injected, place, t.places, size, t.seed, 1, 0, k * tick, tick, thresholds, gain)


def together(work: Sequence[Callable[[], Any]], pool: ThreadPoolExecutor, repeats: int) -> float:
    """Shortest time of several rounds (s), in each of which all threads do their work at once."""
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        for done in [pool.submit(one) for one in work]:
            done.result()
        times.append(time.perf_counter() - started)
    return min(times)


def limit_of(
    simulation: Simulation[Any], seconds: float = SECONDS, repeats: int = 3, threads: int = 1
) -> dict[str, float]:
    """ns a trial-ms of the neurons and of the draws on each of so many processors, and trial-ms/s of all of them."""
    network, coding, engine = simulation.network, simulation.situation.coding, FusedEngine(1)
    bound = engine.bind(network)
    real = network.pending.numpy().dtype.type
    program = Program(real, stepping(bound.functions))
    update, draw = program.kernel(update_alone), program.kernel(draw_alone)
    thresholds, ticks = coding.exploration_thresholds.numpy(), round(1000 * seconds / coding.tick)
    motor, ms = coding.motor_groups[0], ticks * coding.tick
    state = copy.deepcopy(simulation)
    state.run(engine, 1)
    work = engine.bind(state.network).works[coding.tick][0]
    works = [copy.deepcopy(work) for _ in range(threads)]
    with ThreadPoolExecutor(threads) as pool:
        parts = {
            "neurons": [partial(update, bound.tables, one, ms) for one in works],
            "draws": [
                partial(draw, bound.tables, one, motor, thresholds, real(1.0), coding.tick, ticks) for one in works
            ],
        }
        for one in parts.values():
            one[0]()  # compiled
        found = {name: 1e9 * together(one, pool, repeats) / ms for name, one in parts.items()}
    return {**found, "trial_ms_per_s": threads * 1e9 / sum(found.values())}


def limits(seconds: float, repeats: int, threads: int) -> dict[str, dict[str, float]]:
    """By brain."""
    found = {}
    for name, experiment in BRAINS.items():
        simulation = build(compose(f"+experiment={experiment}", "trials=1"))
        simulation.run(FusedEngine(1), round(20_000 / simulation.tick))  # to a state of use
        found[name] = limit_of(simulation, seconds, repeats, threads)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="simulated, a measurement")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--threads", type=int, default=1, help="that do this at once, each a trial of its own")
    arguments = parser.parse_args()
    for name, parts in limits(arguments.seconds, arguments.repeats, arguments.threads).items():
        speed = round(parts.pop("trial_ms_per_s"))
        nanoseconds = {key: round(value, 1) for key, value in parts.items()}
        case = {"brain": name, "threads": arguments.threads}
        print(json.dumps({**case, "ns_per_trial_ms": nanoseconds, "trial_ms_per_s": speed}))


if __name__ == "__main__":
    main()
