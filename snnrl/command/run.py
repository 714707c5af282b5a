"""`snnrl run`: its help and its keys; what runs is `snnrl.run`."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from functools import partial
from typing import Any

from snnrl.command.choices import BASELINES, described, experiments, listing
from snnrl.command.complete import complete
from snnrl.command.keys import Key, keys_of
from snnrl.configuration.compose import outline
from snnrl.errors import ConfigError
from snnrl.running.command import launch
from snnrl.schema import BaselinesConfig, Config

USAGE = """\
Runs an experiment: a file of conf/experiment/, or of FOLDER/experiment/ with --config-dir FOLDER, which says of which
network, world, robot and so on it is made. Any other part is chosen, and any other value set, after it:

    snnrl run experiment=food_attraction
    snnrl run experiment=dual_learning robot=random_walk trials=8 seconds=100 network.dopamine.tau=40
    snnrl run --keys tau            every key with "tau" in it: what it is, its unit, what is allowed, what it means
    snnrl run resume=RUN_FOLDER     the rest of a run that was stopped
"""
ABOUT = ("-h", "--help", "--keys")


def parser() -> ArgumentParser:
    """What `snnrl run` knows of itself; Hydra has further options."""
    made = ArgumentParser(
        description=USAGE, formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False, add_help=False
    )
    overrides = made.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="+KEY=VALUE adds, ~KEY leaves out")
    made.add_argument("-h", "--help", action="store_true", help="show this")
    made.add_argument("--keys", nargs="?", const="", metavar="TEXT", help="list the keys that have TEXT in them")
    made.add_argument("-cd", "--config-dir", metavar="FOLDER", help="of further files of configuration")
    made.add_argument("-c", "--cfg", choices=("job", "hydra", "all"), help="show the configuration and do not run")
    made.add_argument("-m", "--multirun", action="store_true", help="a sweep over KEY=A,B,C")
    made.add_argument("--hydra-help", action="store_true", help="Hydra's further options")
    vars(overrides)["completer"] = complete  # as argcomplete has it
    return made


def help_text(folder: str | None) -> str:
    """What there is to choose."""
    parts = {
        "experiments": experiments(folder),
        "robots, of which each experiment has some": described("robot", folder),
    }
    return "\n\n".join(f"{title}:\n{listing(names)}" for title, names in parts.items())


def find_keys(text: str, overrides: Sequence[str], folder: str | None = None) -> list[Key]:
    """The keys with a text in their path: of the schema, or by the names in tables where an experiment is given.

    Raises:
        ConfigError: there is none.
    """
    kind: type[Any] = Config
    config = "config"
    given = [override for override in overrides if override.lstrip("+") != f"experiment={BASELINES}"]
    if len(given) < len(overrides):
        kind, config = BaselinesConfig, BASELINES
    values = outline(*given, config=config, folder=folder)
    ways = [True] if given else [False, True]
    found = ([key for key in keys_of(kind, values, named) if text in key.path] for named in ways)
    if keys := next(filter(None, found), None):
        return keys
    raise ConfigError("--keys", text, "no key has this in its name")


def show(options: Namespace) -> None:
    """Print the help, or the keys that are asked for."""
    if options.help:
        made = parser()
        made.epilog = help_text(options.config_dir)
        made.print_help()
        return
    text, overrides = options.keys, list(options.overrides)
    if "=" in text:
        text, overrides = "", [text, *overrides]
    for key in find_keys(text, overrides, options.config_dir):
        print(key)


def main() -> None:
    """Run, or tell how."""
    if any(word.split("=")[0] in ABOUT for word in sys.argv[1:]):
        options, _ = parser().parse_known_intermixed_args()
        launch("snnrl run", partial(show, options))
    else:
        from snnrl.run import main  # which needs torch

        main()
