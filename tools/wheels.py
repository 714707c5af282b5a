"""Build the wheel, install it for some Pythons into environments of their own, and run something there.

    python tools/wheels.py [--torch-from FOLDER] PYTHON...      e.g. python3.11 python3.12 python3.13

For each PYTHON: torch as in constraints.txt, then the core, with a short run; then `[all]` on top of it, with another.
The versions are those of constraints.txt. Where torch has no build, the core without it, of which there is the help.
Needs hatchling. Exit status 1 if anything has failed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
CONSTRAINTS = ROOT / "constraints.txt"
NO_BUILD = ("No matching distribution", "ResolutionImpossible")  # what pip says of it, the latter with constraints
RUN = ("run", "experiment=food_attraction", "trials=2", "seconds=10")


@dataclass(frozen=True)
class Row:
    """What has come of one installation; `size` of its packages, and of torch's among them, MB."""

    python: str
    installed: str
    size: float
    torch: float
    result: str

    def __str__(self) -> str:
        return f"| {self.python} | {self.installed} | {self.size:.0f} | {self.torch:.0f} | {self.result} |"


class Environment:
    """A clean one for a Python, in a folder."""

    def __init__(self, python: str, folder: Path) -> None:
        self.folder, self.bin = folder, folder / "bin"
        call(python, "-m", "venv", str(folder))
        self.python = call(str(self.bin / "python"), "--version").removeprefix("Python ").strip()

    def install(self, *words: str) -> None:
        call(str(self.bin / "pip"), "install", "--quiet", "--constraint", str(CONSTRAINTS), *words)

    def size(self, package: str = "") -> float:
        """Of the files that are installed, or of a package's, MB."""
        (packages,) = self.folder.glob("lib/python*/site-packages")
        return sum(path.stat().st_size for path in (packages / package).rglob("*") if path.is_file()) / 1e6

    def row(self, installed: str, result: str) -> Row:
        return Row(self.python, installed, self.size(), self.size("torch"), result)


def call(*command: str, place: Path | None = None) -> str:
    """What a command says that knows nothing of a checkout; RuntimeError with what it complains of if it fails."""
    known = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=place, env=known, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {' '.join(done.stderr.split())[-300:]}")
    return done.stdout


def requirement(name: str) -> str:
    """A package with its version."""
    return next(line for line in CONSTRAINTS.read_text().splitlines() if line.startswith(f"{name}=="))


def run(environment: Environment, name: str, events: bool) -> str:
    """A short run, from a folder where nothing of the checkout is; whether it left what it should."""
    place = environment.folder / name
    place.mkdir()
    call(str(environment.bin / "snnrl"), *RUN, "hydra.run.dir=out", place=place)
    food = (place / "out" / "trials.csv").read_text().splitlines()[1:]
    if len(food) != 2 or bool(list(place.glob("out/events*"))) != events:
        raise RuntimeError(f"snnrl run left {sorted(path.name for path in (place / 'out').iterdir())}")
    return "runs, with events" if events else "runs, without events"


def check(python: str, wheel: Path, torch_from: Path | None, folder: Path) -> Iterator[Row]:
    """The rows of one Python."""
    environment = Environment(python, folder)
    local = () if torch_from is None else ("--no-index", "--no-deps", "--find-links", str(torch_from))
    try:
        environment.install(*local, requirement("torch"))
    except RuntimeError as error:
        if not any(said in str(error) for said in NO_BUILD):
            raise
        environment.install("--no-deps", str(wheel))
        dependencies = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
        environment.install(*(name for name in dependencies if not name.startswith("torch")))
        call(str(environment.bin / "snnrl"), "run", "--help", place=folder)
        call(str(environment.bin / "snnrl"), "run", "--keys", "tau", "experiment=food_attraction", place=folder)
        yield environment.row("core without torch", f"no build of {requirement('torch')}; help and keys")
        return
    environment.install(str(wheel))
    yield environment.row("core", run(environment, "core", events=False))
    environment.install(f"{wheel}[all]")
    yield environment.row("[all]", run(environment, "all", events=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pythons", nargs="+", metavar="PYTHON", help="interpreters: names on the PATH, or paths")
    parser.add_argument("--torch-from", type=Path, help="a folder of wheels where torch is; otherwise pip's index")
    arguments = parser.parse_args()
    failed = False
    print("| Python | installed | packages, MB | of which torch, MB | result |\n|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as place:
        call(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", place, place=ROOT)
        (wheel,) = Path(place).glob("*.whl")
        for number, python in enumerate(arguments.pythons):
            try:
                for row in check(python, wheel, arguments.torch_from, Path(place, str(number))):
                    print(row, flush=True)
            except (RuntimeError, OSError) as error:
                failed = True
                print(f"| {python} | | | | failed: {error} |", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
