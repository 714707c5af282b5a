"""Agents without neurons in the robot's world: baselines to compare with, and environments for other libraries.

What decides the wheels in place of a network belongs here, and what it needs to do so.
"""
