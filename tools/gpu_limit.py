"""What the neurons and the random numbers of a brain cost alone on an NVIDIA GPU: the limit of its engine there.

    python tools/gpu_limit.py [--trials 1000] [--seconds 20] [--repeats 5]

As `tools/limit.py` on the CPU: the neurons of all trials are updated in every ms by the CUDA engine's own functions,
and what a tick draws is drawn; nothing is sent or learnt, and there is no world. Prints one JSON line a brain:
trial-milliseconds a second.
"""

from __future__ import annotations

import argparse
import copy
import json
import time
from typing import Any

import torch
from limit import BRAINS
from numba import cuda, types

from snnrl.configuration.builder import build
from snnrl.configuration.compose import compose
from snnrl.engines.cuda.coding import explore
from snnrl.engines.cuda.engine import CudaEngine, array_of, on_device
from snnrl.engines.cuda.network import ELEMENT, begin
from snnrl.engines.cuda.neurons import update_cells
from snnrl.engines.fused.coding import coding_arrays
from snnrl.errors import ConfigError
from snnrl.simulation import Simulation


def all_alone(t, s, scratch, time, coding, ticks, raster):  # type: ignore[no-untyped-def]
    """Neurons and draws of a block's trial for so many control ticks."""
    trial = cuda.blockIdx.x
    doubles = cuda.shared.array(0, types.float64)
    reals = cuda.shared.array(0, ELEMENT)
    whole = cuda.shared.array(0, types.uint32)
    w = begin(t, s, scratch, doubles, reals, whole, trial, cuda.threadIdx.x)
    for k in range(ticks):
        first = time + k * coding.tick
        for row in range(coding.tick):
            explore(t.tables, w, coding, trial, first + row, first)
            update_cells(t, s, w, trial, first + row, 0, 0, raster, 0)


def limit_of(simulation: Simulation[Any], seconds: float = 10.0, repeats: int = 3) -> float:
    """Trial-ms/s of the neurons and the draws of all trials; the first run, which compiles, does not count."""
    state = copy.deepcopy(simulation)
    network, coding = state.network, state.situation.coding
    launch = CudaEngine().launch(network, 0, 0)
    arrays = on_device(coding_arrays(coding, network, state.situation.world, array_of), network.device)
    nobody = array_of(torch.zeros(0, 0, 0, dtype=torch.uint8, device=network.device))
    ticks = max(1, round(1000 * seconds / coding.tick))
    times = []
    for count in (1, *[ticks] * repeats):
        started = time.perf_counter()
        launch(all_alone, count * coding.tick, arrays, count, nobody)
        times.append(time.perf_counter() - started)
    return network.trials * ticks * coding.tick / min(times[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated, a measurement")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    try:
        CudaEngine()
    except ConfigError as error:
        raise SystemExit(f"gpu_limit.py: {error}") from None
    for name, experiment in BRAINS.items():
        simulation = build(compose(f"+experiment={experiment}", f"trials={arguments.trials}")).to("cuda")
        speed = limit_of(simulation, arguments.seconds, arguments.repeats)
        print(json.dumps({"brain": name, "trials": arguments.trials, "trial_ms_per_s": round(speed)}))


if __name__ == "__main__":
    main()
