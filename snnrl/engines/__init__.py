"""Engines: different ways to run the same networks in the same situations, behind one interface.

Here belongs how time is advanced. Engines know the model and the body, and nothing of runs, records or configurations.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

from snnrl.body.world import World
from snnrl.engines.interface import Engine, Situation
from snnrl.engines.reference import ReferenceEngine
from snnrl.errors import ConfigError

if TYPE_CHECKING:
    from snnrl.engines.fused.foraging import CompiledWorld


def make_engine(name: str, device: str, threads: int = 0) -> Engine:
    """The engine of that name; `auto` is the fused one on the CPU, the CUDA one on a GPU, the reference elsewhere.

    Raises:
        ConfigError: if an engine is asked for a device that it cannot run on, or needs what is not installed.
    """
    if name == "cuda" or (name == "auto" and device.partition(":")[0] == "cuda"):
        return _make_cuda(device)
    if not _is_fused(name, device):
        return ReferenceEngine()
    from snnrl.engines.fused import FusedEngine

    return FusedEngine(threads)


def _make_cuda(device: str) -> Engine:
    if find_spec("numba_cuda") is None:
        raise ConfigError("engine", "cuda", 'needs numba-cuda: pip install "snnrl[cuda]"; or use engine=reference')
    from snnrl.engines.cuda import CudaEngine

    engine = CudaEngine()
    if device.partition(":")[0] != engine.device:
        raise ConfigError("engine", "cuda", f"runs on device={engine.device} only, not on device={device}")
    return engine


def _is_fused(name: str, device: str) -> bool:
    on_cpu = device == "cpu"
    if name == "fused" and not on_cpu:
        raise ConfigError("engine", name, f"runs on device=cpu only, not on device={device}")
    return name != "reference" and on_cpu


def compiled_world(name: str, world: World, ranges: Sequence[str], touches: Sequence[str]) -> CompiledWorld | None:
    """What moves the robots of a world that has no networks, for an engine of that name; None is the world itself.

    Args:
        ranges, touches: names of range and touch sensors, see `CompiledWorld`.

    Raises:
        ConfigError: if the fused engine is asked for a device that it cannot run on, or a world has its own code.
    """
    if not _is_fused(name, world.touches.device.type):
        return None
    from snnrl.engines.fused.foraging import CompiledWorld

    return CompiledWorld(world, ranges, touches)


__all__ = ["Engine", "ReferenceEngine", "Situation", "compiled_world", "make_engine"]
