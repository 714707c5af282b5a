"""Spiking neural networks that learn from reward by dopamine-modulated STDP, and a robot that proves it."""

from importlib.metadata import version

from snnrl import schema
from snnrl.body.robot import Robot
from snnrl.body.world import World
from snnrl.configuration.builder import build, build_network
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
    "make_engine",
    "record",
    "run_network",
    "run_simulation",
    "schema",
]
