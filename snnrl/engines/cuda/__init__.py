"""The CUDA engine: the whole closed loop compiled for NVIDIA GPUs, a block of threads for each trial.

Its files are called like those of `snnrl.model` and `snnrl.body` whose mechanisms they run; what is one number at a
time in the fused engine, a trial's world and its modulators, is compiled from there.
"""

from snnrl.engines.cuda.engine import CudaEngine

__all__ = ["CudaEngine"]
