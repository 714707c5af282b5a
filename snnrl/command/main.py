"""`snnrl COMMAND ...`: one name for all commands, each of which is `python -m snnrl.COMMAND ...` too.

Only the module of the chosen command is imported, so that help and completion come at once.
"""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from importlib import import_module

import argcomplete

import snnrl
from snnrl.extras import demand

COMMANDS = {  # what each is for, the module with its `parser` and `main`, and the extra that it needs
    "run": ("an experiment, or the rest of one that was stopped", "snnrl.command.run", ""),
    "sweep": ("an experiment for every combination of values KEY=A,B,C", "snnrl.command.sweep", ""),
    "collect": ("one table of many runs", "snnrl.running.merge", "statistics"),
    "replay": ("one trial of a run again, with everything recorded", "snnrl.replay.replay", "figures"),
    "reproduce": ("every experiment of the thesis, and a report", "snnrl.thesis.reproduce", "thesis"),
    "calibrate": ("fit the values on which the thesis is silent", "snnrl.thesis.calibrate", "calibration"),
    "search": ("search the parameters of STDP for the most food", "snnrl.thesis.search", "calibration"),
    "bench": ("how fast robots are simulated on this machine", "snnrl.command.bench", ""),
    "new": ("an experiment of your own, to begin with", "snnrl.command.new", ""),
}
USAGE = """\
Spiking neural networks that learn from reward by dopamine-modulated STDP, and a robot that proves it.

    snnrl run experiment=food_attraction
    snnrl COMMAND --help

To complete commands, experiments and keys with TAB: eval "$(register-python-argcomplete snnrl)"

commands:
"""


def tree(chosen: str | None) -> ArgumentParser:
    """All commands; the chosen one with its arguments."""
    lines = "\n".join(f"  {name:<9}  {line}" for name, (line, *_) in COMMANDS.items())
    parser = ArgumentParser("snnrl", description=USAGE + lines, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"snnrl {snnrl.__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, help="one of them, and what belongs to it")
    for name, (_, module, _) in COMMANDS.items():
        own = [import_module(module).parser()] if name == chosen else []
        commands.add_parser(name, parents=own, add_help=not own)
    return parser


def main() -> None:
    """Run the command that the command line names, or complete what is typed so far."""
    completing = "_ARGCOMPLETE" in os.environ
    words = os.environ["COMP_LINE"].split()[1:] if completing else sys.argv[1:]
    chosen = words[0] if words and words[0] in COMMANDS else None
    if completing or chosen is None:
        parser = tree(chosen)
        argcomplete.autocomplete(parser)
        parser.parse_args()
    else:
        sys.argv = [f"snnrl {chosen}", *words[1:]]
        _, module, extra = COMMANDS[chosen]
        if extra:
            demand(f"snnrl {chosen}", extra)
        import_module(module).main()


if __name__ == "__main__":
    main()
