"""The fused engine: the whole closed loop compiled for the CPU, threads over trials.

Its files are called like those of `snnrl.model` and `snnrl.body` whose mechanisms they run.
"""

from snnrl.engines.fused.engine import FusedEngine

__all__ = ["FusedEngine"]
