"""Importing this registers the environments with Gymnasium; see `snnrl.agents.environments`.

Raises:
    ImportError: Gymnasium is not installed.
"""

from snnrl.extras import lacks

if line := lacks("environments"):
    raise ImportError(f"snnrl.environments: {line}")

from snnrl.agents.environments import ForagingEnv, ForagingVectorEnv

__all__ = ["ForagingEnv", "ForagingVectorEnv"]
