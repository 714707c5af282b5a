"""The fused engine: the whole closed loop compiled for the CPU, threads over trials."""

from snnrl.engines.fused.engine import FusedEngine

__all__ = ["FusedEngine"]
