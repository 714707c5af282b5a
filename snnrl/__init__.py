"""Spiking neural networks that learn from reward by dopamine-modulated STDP, and a robot that proves it."""

from snnrl import schema
from snnrl.builder import build, build_network, build_task
from snnrl.engines import make_engine
from snnrl.loop import Simulation, TaskSimulation
from snnrl.network import Network
from snnrl.neurons import NeuronGroup
from snnrl.random import Draws
from snnrl.synapses import Projection
from snnrl.world import World

__all__ = [
    "Draws",
    "Network",
    "NeuronGroup",
    "Projection",
    "Simulation",
    "TaskSimulation",
    "World",
    "build",
    "build_network",
    "build_task",
    "make_engine",
    "schema",
]
