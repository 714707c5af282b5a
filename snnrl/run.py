"""The main job from the command line.

python -m snnrl.run experiment=NAME [robot=NAME] [trials=N] [seconds=S] [seed=K] [engine=...] [device=...]
python -m snnrl.run resume=RUN_FOLDER
python -m snnrl.run experiment=baselines     # see `snnrl.agents.baselines`
"""

from __future__ import annotations

import sys
from pathlib import Path

from snnrl.errors import ConfigError
from snnrl.extras import demand
from snnrl.running import jobs
from snnrl.running.command import hydra_job, launch

BASELINES = ("experiment=baselines", "+experiment=baselines")


def main() -> None:
    arguments = sys.argv[1:]
    resumed = [argument.removeprefix("resume=") for argument in arguments if argument.startswith("resume=")]

    def start() -> None:
        if resumed and len(arguments) > 1:
            raise ConfigError("resume", resumed[0], "goes alone, its config.yaml says the rest")
        if resumed:
            jobs.resume(Path(resumed[0]))
        elif chosen := [argument for argument in arguments if argument in BASELINES]:
            demand("snnrl.run", "figures")
            from snnrl.agents import baselines

            sys.argv.remove(chosen[0])
            hydra_job(baselines.job, "baselines")
        else:
            hydra_job(jobs.job, "config")

    launch("snnrl.run", start)


if __name__ == "__main__":
    main()
