"""What can be chosen on the command line: the files of `conf/` and of a folder of one's own, and what they are for."""

from __future__ import annotations

from pathlib import Path

from snnrl.configuration.compose import conf_dir

BASELINES = "baselines"


def purpose(path: Path) -> str:
    """The first comment of a file that is for its readers."""
    comments = (line[1:].strip() for line in path.read_text().splitlines() if line.startswith("#"))
    return next((comment for comment in comments if not comment.startswith("@package")), "")


def described(group: str, folder: str | None = None) -> dict[str, str]:
    """The files of a group, by their names, and what each is for.

    Args:
        folder: where there may be more of them.
    """
    places = [Path(place, group) for place in (conf_dir(), folder) if place]
    return {path.stem: purpose(path) for place in places for path in sorted(place.glob("*.yaml"))}


def experiments(folder: str | None = None) -> dict[str, str]:
    """All experiments and what each is for; the comparison with other agents is one, too."""
    return {**described("experiment", folder), BASELINES: purpose(Path(conf_dir(), f"{BASELINES}.yaml"))}


def listing(names: dict[str, str]) -> str:
    """Lines of help, a name each."""
    width = max(map(len, names), default=0)
    return "\n".join(f"  {name:<{width}}  {line}" for name, line in names.items())
