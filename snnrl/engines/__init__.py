"""Engines: different ways to run the same networks in the same situations, behind one interface.

Here belongs how time is advanced. Engines know the model and the body, and nothing of runs, records or configurations.
"""

from __future__ import annotations

from snnrl.engines.interface import Engine, Situation
from snnrl.engines.reference import ReferenceEngine
from snnrl.errors import ConfigError


def make_engine(name: str, device: str, threads: int = 0) -> Engine:
    """The engine of that name; `auto` is the fused one on the CPU, the reference elsewhere.

    Raises:
        ConfigError: if the fused engine is asked for a device that it cannot run on.
    """
    on_cpu = device == "cpu"
    if name == "fused" and not on_cpu:
        raise ConfigError("engine", name, f"runs on device=cpu only, not on device={device}")
    if name == "reference" or not on_cpu:
        return ReferenceEngine()
    from snnrl.engines.fused import FusedEngine

    return FusedEngine(threads)


__all__ = ["Engine", "ReferenceEngine", "Situation", "make_engine"]
