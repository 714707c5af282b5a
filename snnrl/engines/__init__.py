"""Engines: different ways to run the same networks in the same situations, behind one interface.

Here belongs how time is advanced. Engines know the model and the body, and nothing of runs, records or configurations.
"""

from __future__ import annotations

from importlib.util import find_spec

from snnrl.engines.interface import Engine, Situation
from snnrl.engines.reference import ReferenceEngine
from snnrl.errors import ConfigError


def make_engine(name: str, device: str, threads: int = 0) -> Engine:
    """The engine of that name; `auto` is the fused one on the CPU, the reference elsewhere.

    Raises:
        ConfigError: if an engine is asked for a device that it cannot run on, or needs what is not installed.
    """
    on_cpu = device == "cpu"
    if name == "fused" and not on_cpu:
        raise ConfigError("engine", name, f"runs on device=cpu only, not on device={device}")
    if name == "cuda":
        return _make_cuda(device)
    if name == "reference" or not on_cpu:
        return ReferenceEngine()
    from snnrl.engines.fused import FusedEngine

    return FusedEngine(threads)


def _make_cuda(device: str) -> Engine:
    if find_spec("numba_cuda") is None:
        raise ConfigError("engine", "cuda", 'needs numba-cuda: pip install "snnrl[cuda]"')
    from snnrl.engines.cuda import CudaEngine

    engine = CudaEngine()
    if device.partition(":")[0] != engine.device:
        raise ConfigError("engine", "cuda", f"runs on device={engine.device} only, not on device={device}")
    return engine


__all__ = ["Engine", "ReferenceEngine", "Situation", "make_engine"]
