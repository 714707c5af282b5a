"""The main job from the command line.

python -m snnrl.run +experiment=NAME [robot=NAME] [trials=N] [seconds=S] [seed=K] [engine=...] [device=...]
python -m snnrl.run resume=RUN_FOLDER

Exit status: 0, or 2 for bad input, 1 for anything else that went wrong, 130 after SIGINT, 143 after SIGTERM.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from snnrl.config import conf_dir, guarded, load, plain
from snnrl.files import FolderError
from snnrl.job import Interrupted, perform
from snnrl.schema import ConfigError

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


def job(composed: DictConfig) -> float:
    """One Hydra job; returns its score, so that a sweeper can optimise it."""
    settings = HydraConfig.get()
    folder = Path(settings.runtime.output_dir)
    overrides = list(settings.overrides.task)
    try:
        summary = perform(plain(composed), folder, overrides, share(settings.launcher))
    except Exception as error:
        if isinstance(error, ConfigError):
            discard(folder)
        if settings.mode == RunMode.RUN or isinstance(error, Interrupted):
            raise Passed(error) from error
        failure = f"job {settings.job.num} ({' '.join(overrides)}): {explain(error)}"
        print(f"snnrl.run: {failure}", file=sys.stderr)
        again = f"the same command with hydra.sweep.dir={settings.sweep.dir} does only what is missing"
        raise JobFailed(f"{failure}; {again}") from error
    report(summary, folder)
    return score(summary)


def share(launcher: DictConfig) -> int:
    """Threads for a job that was not told how many: what its launcher gives it, else 0, one per processor."""
    told = str(launcher.get("cpus_per_task") or os.environ.get("OMP_NUM_THREADS", ""))  # joblib sets the latter
    return int(told) if told.isdigit() else 0


def resume(folder: Path) -> None:
    """Go on with the run in a folder."""
    if not (folder / "config.yaml").is_file():
        raise FolderError(f"resume={folder}: no run folder (there is no config.yaml in it)")
    report(perform(load(folder / "config.yaml"), folder), folder)


def score(summary: dict[str, Any]) -> float:
    """Mean food of a robot, mean number of rewards of a task."""
    results = summary["results"]
    return float(results.get("food_mean", results.get("rewards", math.nan)))


def report(summary: dict[str, Any], folder: Path) -> None:
    """Print the result of a run in a few lines."""
    print(f"{summary['experiment']}, {summary['robot']}: {summary['trials']} trials x {summary['seconds']:.0f} s")
    results = dict(summary["results"])
    if "food_mean" in results:
        mean, sd, learnt = (results.pop(key) for key in ("food_mean", "food_sd", "correct_fraction"))
        print(f"  food collected   {mean:.1f}{'' if sd is None else f' (SD {sd:.1f})'}")
        if learnt is not None:
            print(f"  learnt           {learnt:.0%} of trials")
    for key, value in results.items():
        print(f"  {key.replace('_', ' '):<16} {value:.4g}")
    print(f"  took             {summary['wall_s']:.1f} s, {summary['trial_ms_per_s'] / 1e6:.2f} million trial-ms/s")
    print(f"  results          {folder}")


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
        if isinstance(cause, OmegaConfBaseException) and cause.full_key:
            if "experiment.name" in str(cause) or cause.full_key == "experiment.name":
                names = sorted(path.stem for path in Path(conf_dir(), "experiment").glob("*.yaml"))
                return f"experiment: must be given as +experiment=NAME, NAME one of {', '.join(names)}"
            text = str(cause).splitlines()[0]
            if is_dataclass(cause.object_type) and ("not in" in text or "not a" in text):
                allowed = ", ".join(field.name for field in fields(cause.object_type))
                return f"{cause.full_key}: no such key; allowed here: {allowed}"
            return f"{cause.full_key}: {text}"
        cause = cause.__cause__
    text, _, _ = str(error).partition("Config search path")
    if not isinstance(error, (*BAD_INPUT, JobFailed, Interrupted)):
        text = f"{type(error).__name__}: {text}"
    return " ".join(text.split())


def launch(program: str, start: Callable[[], None]) -> None:
    """Run a command line; on an error one clear line (all of it with HYDRA_FULL_ERROR=1) and its exit status."""
    wants_traceback = os.environ.get("HYDRA_FULL_ERROR") == "1"
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then hands its errors on instead of printing them
    threading.excepthook = _unless_foreseen
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
    """What a Hydra application does, with the configuration of that name."""
    with guarded():
        hydra.main(version_base="1.3", config_path=conf_dir(), config_name=config)(job)()


def main() -> None:
    arguments = sys.argv[1:]
    resumed = [argument.removeprefix("resume=") for argument in arguments if argument.startswith("resume=")]

    def start() -> None:
        if not resumed:
            hydra_job(job, "config")
        elif len(arguments) == 1:
            resume(Path(resumed[0]))
        else:
            raise ConfigError("resume", resumed[0], "goes alone, its config.yaml says the rest")

    launch("snnrl.run", start)


if __name__ == "__main__":
    main()
