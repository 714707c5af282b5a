"""The robot's body: its world, its sensors, and the coding that joins them to a network.

Here belongs what happens inside a control tick of a robot. Nothing here steps a network.
"""
