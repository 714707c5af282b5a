"""Spiking neural networks that learn from reward by dopamine-modulated STDP, and a robot that proves it."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from snnrl import plot, schema
    from snnrl.body.robot import Robot
    from snnrl.body.world import World
    from snnrl.configuration.builder import build, build_network
    from snnrl.data import load, table
    from snnrl.engines import make_engine
    from snnrl.model.draws import Draws
    from snnrl.model.network import Network
    from snnrl.model.neurons import NeuronGroup
    from snnrl.model.synapses import Projection
    from snnrl.recording.monitors import Monitor, record, run_network, run_simulation
    from snnrl.simulation import Simulation

__version__ = version("snnrl")

__all__ = [
    "Draws",
    "Monitor",
    "Network",
    "NeuronGroup",
    "Projection",
    "Robot",
    "Simulation",
    "World",
    "__version__",
    "build",
    "build_network",
    "load",
    "make_engine",
    "plot",
    "record",
    "run_network",
    "run_simulation",
    "schema",
    "table",
]

MODULES = {
    "Draws": "snnrl.model.draws",
    "Monitor": "snnrl.recording.monitors",
    "Network": "snnrl.model.network",
    "NeuronGroup": "snnrl.model.neurons",
    "Projection": "snnrl.model.synapses",
    "Robot": "snnrl.body.robot",
    "Simulation": "snnrl.simulation",
    "World": "snnrl.body.world",
    "build": "snnrl.configuration.builder",
    "build_network": "snnrl.configuration.builder",
    "load": "snnrl.data",
    "make_engine": "snnrl.engines",
    "record": "snnrl.recording.monitors",
    "run_network": "snnrl.recording.monitors",
    "run_simulation": "snnrl.recording.monitors",
    "table": "snnrl.data",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for: help and completion on the command line need no torch, which takes seconds."""
    if name in ("plot", "schema"):
        return import_module(f"snnrl.{name}")
    if name in MODULES:
        return getattr(import_module(MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
