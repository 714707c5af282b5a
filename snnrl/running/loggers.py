"""The loggers that a configuration names; see `snnrl.recording.logger`."""

from __future__ import annotations

from snnrl.configuration.functions import function
from snnrl.errors import ConfigError
from snnrl.extras import lacks
from snnrl.recording.logger import Logger
from snnrl.schema import RecordConfig

TENSORBOARD = "tensorboard"


def tensorboard() -> Logger:
    """Needs the extra `dashboards`."""
    from snnrl.recording.board import Board

    return Board()


def mlflow() -> Logger:
    """Needs the extra `mlflow`."""
    if line := lacks("mlflow"):
        raise ConfigError("record.loggers", "mlflow", line)
    from snnrl.recording.tracking import Tracking

    return Tracking()


OWN = {"mlflow": mlflow}


def loggers_of(config: RecordConfig) -> dict[str, Logger]:
    """The loggers by the names that the configuration has for them; TensorBoard's only where it is installed.

    Raises:
        ConfigError: there is no logger of that name, or it needs what is not installed.
    """
    found = {TENSORBOARD: tensorboard()} if config.tensorboard and not lacks("dashboards") else {}
    return found | {name: function("record.loggers", name, OWN)() for name in config.loggers}
