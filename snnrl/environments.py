"""Importing this registers the environments with Gymnasium; see `snnrl.agents.environments`."""

from snnrl.agents.environments import ForagingEnv, ForagingVectorEnv

__all__ = ["ForagingEnv", "ForagingVectorEnv"]
