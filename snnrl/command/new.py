"""`snnrl new`: an experiment of one's own, to begin with.

FOLDER/experiment/NAME.yaml is written, where NAME is what the folder is called; nothing that is there is overwritten.
"""

from __future__ import annotations

import argparse
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from snnrl.errors import ConfigError
from snnrl.files import FolderError, write
from snnrl.running.command import launch


def begin(folder: Path) -> Path:
    """Write a minimal experiment that runs; returns its file.

    Raises:
        ConfigError: the folder's name cannot be an experiment's.
        FolderError: the file is there already.
    """
    name = folder.resolve().name
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise ConfigError("FOLDER", folder, "its name must be a letter, then letters, digits and _")
    file = folder / "experiment" / f"{name}.yaml"
    if file.exists():
        raise FolderError(f"{file}: is there already")
    file.parent.mkdir(parents=True, exist_ok=True)
    template = files("snnrl.command").joinpath("templates", "experiment.yaml").read_text()
    write(file, Template(template).substitute(folder=folder, name=name))
    return file


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("folder", type=Path, metavar="FOLDER", help="made if it is not there")
    return made


def main() -> None:
    folder = parser().parse_args().folder

    def start() -> None:
        file = begin(folder)
        print(f"{file}\nsnnrl run --config-dir {folder} experiment={file.stem}")

    launch("snnrl new", start)
