"""An experiment beyond the thesis, from its runs to the table and the figure of its page.

    python -m snnrl.beyond EXPERIMENT [--part P] [--page docs/beyond/EXPERIMENT.md] [KEY=VALUE ...]

All agents run at the page's sizes, or a part of them; KEY=VALUE changes the configuration of every run (trials=8,
seed=3). The table and the figure are written to runs/beyond/EXPERIMENT/TIME, and with --page also put into the page.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from snnrl.beyond import avoidance, baseline, chain, changing_world, credit, extinction, in_network, obstacles, regimes
from snnrl.beyond.page import Page, around_table
from snnrl.errors import ConfigError
from snnrl.running.command import FORESEEN, explain, status

EXPERIMENTS: dict[str, Callable[[Sequence[str], float], Page]] = {
    "changing_world": changing_world.make,
    "chain": chain.make,
    "extinction": extinction.make,
    "regimes": regimes.make,
    "avoidance": avoidance.make,
    "baseline": baseline.make,
    "in_network": in_network.make,
    "credit": credit.make,
    "obstacles": obstacles.make,
}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", choices=EXPERIMENTS)
    parser.add_argument("--part", type=float, default=1.0, help="of the page's length (default 1)")
    parser.add_argument("--page", type=Path, help="the document that gets the table and the figure")
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="of the configuration of every run")
    options = parser.parse_intermixed_args(arguments)
    torch.set_num_threads(1)  # an agent's operations are too small to be shared out
    folder = Path("runs/beyond") / options.experiment / time.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        if not 0.0 < options.part <= 1.0:
            raise ConfigError("--part", options.part, "must be greater than 0 and at most 1")
        if options.page:
            around_table(options.page)
        page = EXPERIMENTS[options.experiment](options.overrides, options.part)
        part = [] if options.part == 1.0 else [f"--part {options.part:g}"]
        how = " ".join(["python -m snnrl.beyond", options.experiment, *part, *options.overrides])
        page = replace(page, table=f"{page.table}\nMade by `{how}`.\n")
        folder.mkdir(parents=True, exist_ok=True)
        page.save(folder)
        if options.page:
            page.put_into(options.page)
    except FORESEEN as error:
        print(f"snnrl.beyond: {explain(error)}", file=sys.stderr)
        sys.exit(status(error))
    print(page.table, end="")
    print(f"results in {folder}")
