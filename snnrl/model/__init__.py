"""The network and its mechanisms: neurons, synapses, plasticity, modulators, homeostasis, and the random numbers
that everything is drawn from.

Here belongs what happens inside a millisecond. Nothing here knows of a body, a task, an engine or a file.
"""
