"""What every command shares: how it starts, how it fails in one line, and its exit status.

Exit status: 0, or 2 for bad input, 1 for anything else that went wrong, 130 after SIGINT, 143 after SIGTERM.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from snnrl.configuration.compose import conf_dir
from snnrl.configuration.loader import guarded
from snnrl.configuration.refusals import Refusal, reason
from snnrl.errors import ConfigError
from snnrl.files import FolderError
from snnrl.running.signals import Interrupted

BAD_INPUT = (ConfigError, FolderError, HydraException, OmegaConfBaseException)

LONGEST = 500  # characters of an error's line


class Passed(BaseException):
    """Carries an exception past Hydra, which would print lines of its own about it."""

    def __init__(self, error: Exception) -> None:
        super().__init__(error)
        self.error = error


class JobFailed(Exception):
    """A job of a sweep has failed; the message says which, why, and how to run it again."""


FORESEEN = (*BAD_INPUT, JobFailed, Interrupted, OSError, KeyboardInterrupt)


def discard(folder: Path) -> None:
    """Remove the run folder that Hydra has just made, and folders above it in here, if they are empty."""
    for empty in (folder, *folder.parents):
        if (Path.cwd() not in empty.parents and empty != folder) or any(empty.iterdir()):
            return
        empty.rmdir()


def explain(error: BaseException | None) -> str:
    """A configuration error in one line: key, value, what is allowed."""
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in _explanation(error).strip())
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


def _explanation(error: BaseException | None) -> str:
    cause = error
    while cause is not None:
        if isinstance(cause, OmegaConfBaseException) and "experiment.name" in f"{cause} {cause.full_key}":
            names = sorted(["baselines", *(path.stem for path in Path(conf_dir(), "experiment").glob("*.yaml"))])
            return f"experiment: must be given as experiment=NAME, NAME one of {', '.join(names)}"
        cause = cause.__cause__
    if isinstance(error, (HydraException, OmegaConfBaseException)):
        return reason(error)
    text = " ".join(str(error).split())
    return text if isinstance(error, (*BAD_INPUT, JobFailed, Interrupted)) else f"{type(error).__name__}: {text}"


def launch(program: str, start: Callable[[], None]) -> None:
    """Run a command line; on an error one clear line (all of it with HYDRA_FULL_ERROR=1) and its exit status."""
    wants_traceback = os.environ.get("HYDRA_FULL_ERROR") == "1"
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then hands its errors on instead of printing them
    threading.excepthook = _unless_foreseen
    gc.freeze()  # what has been imported stays: to look through it again and again takes a part of every start
    try:
        start()
    except (*FORESEEN, Passed) as caught:
        error = caught.error if isinstance(caught, Passed) else caught
        if wants_traceback or not isinstance(error, FORESEEN):
            raise
        print(f"{program}: {explain(error)}", file=sys.stderr)
        sys.exit(status(error))


def _unless_foreseen(raised: threading.ExceptHookArgs) -> None:
    """Print what ended a thread, unless it is the events' writer on a full disk, which `Recorder` will hear of."""
    if not isinstance(raised.exc_value, OSError):
        threading.__excepthook__(raised)


def status(error: BaseException) -> int:
    """The exit status for an error."""
    if isinstance(error, Interrupted):
        return 128 + error.number
    if isinstance(error, KeyboardInterrupt):
        return 128 + signal.SIGINT
    return 2 if isinstance(error, BAD_INPUT) else 1


def hydra_job(job: Callable[[DictConfig], float | None], config: str) -> None:
    """What a Hydra application does, with the configuration of that name.

    Raises:
        ConfigError: for options that Hydra does not have, and for the one by which it would unpickle a file.
    """

    def refuse(message: str) -> NoReturn:
        raise Refusal(f"{message}; options go before or after all KEY=VALUE, --help lists them")

    parser = get_args_parser()
    parser.error = refuse  # type: ignore[method-assign]
    parser.allow_abbrev = False
    if parser.parse_args().experimental_rerun is not None:
        raise Refusal("--experimental-rerun: is not supported; resume=RUN_FOLDER goes on with a run")
    with guarded():
        hydra.main(version_base="1.3", config_path=conf_dir(), config_name=config)(job)()
