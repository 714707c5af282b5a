"""The robot's body: its world, its sensors, and the coding that joins them to a network.

Nothing here steps a network.
"""
