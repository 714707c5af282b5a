"""The report: one self-contained HTML page, Markdown with figures, and JSON of every cell."""

from __future__ import annotations

import base64
import io
import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from PIL import Image

from snnrl.drawing.palette import ROBOTS
from snnrl.drawing.style import encoded, spoken
from snnrl.files import finite, write, write_json
from snnrl.recording.runs import Run
from snnrl.thesis.claims import Claim, claims, escapes, first_food
from snnrl.thesis.compare import Cell, compare, enough, tally
from snnrl.thesis.fit import calibration, pins, points, within_noise
from snnrl.thesis.gallery import drawings
from snnrl.thesis.loss import UNIT
from snnrl.thesis.verdicts import RULE, Sample, Share

TEMPLATES = Path(__file__).with_name("templates")
SECTIONS = {
    "3": "Methods",
    "4.1": "Orbit",
    "4.2": "Food attraction",
    "4.3": "Food, then poison",
    "4.4": "A secondary stimulus",
    "4.5": "A secondary behaviour",
    "4.6": "Two behaviours at once",
}


@dataclass(frozen=True)
class Provenance:
    """What the report was made from."""

    seed: int
    code: str
    versions: dict[str, str]
    python: str
    machine: str
    quick: bool
    simulated_s: float
    running_s: float
    found: int


def value(number: float, digits: int = 3) -> str:
    """A number as people write it: `digits` significant ones, none lost before the point."""
    if number != number or number in (float("inf"), float("-inf")):
        return "-"
    if number == 0 or abs(number) >= 10**digits:
        return f"{number:.0f}"
    text = f"{number:.{digits}g}"
    return f"{float(text):g}" if "e" in text else text


def shown(sample: Sample | Share, unit: str) -> str:
    """Mean (SD), or percentage (count of n)."""
    if isinstance(sample, Share):
        return f"{100 * sample.mean:.0f} % ({sample.count} of {sample.n})"
    return value(sample.mean, 4) + (f" ({value(sample.sd)})" if sample.sd is not None else "")


def row(cell: Cell) -> dict[str, str]:
    """A cell of the comparison in words."""
    scale = 100 if isinstance(cell.ours, Share) else 1
    unit = " points" if isinstance(cell.ours, Share) else f" {cell.unit}"
    d = cell.difference
    relative = (
        "" if scale == 100 or not cell.published.mean else f" ({round(100 * d.value / cell.published.mean):+d} %)"
    )
    return {
        "experiment": spoken(cell.experiment),
        "robot": spoken(cell.robot),
        "colour": ROBOTS[cell.robot],
        "quantity": cell.quantity,
        "published": shown(cell.published, cell.unit),
        "ours": shown(cell.ours, cell.unit),
        "trials": value(cell.ours.n),
        "difference": f"{value(scale * d.value)}{unit}{relative}",
        "interval": f"{value(scale * d.low)} to {value(scale * d.high)}",
        "effect": value(d.effect, 2),
        "needed": "not with the published n" if math.isinf(d.trials_needed) else value(d.trials_needed),
        "verdict": cell.verdict,
    }


def claim_row(claim: Claim) -> dict[str, Any]:
    return {
        **asdict(claim),
        "value": f"{value(claim.value)} {claim.unit}".strip(),
        "interval": f"{value(claim.low)} to {value(claim.high)}",
        "verdict": "holds" if claim.holds else "does not hold",
    }


def compressed(content: bytes) -> bytes:
    """A PNG file made smaller: few colours are enough for lines and areas."""
    picture = Image.open(io.BytesIO(content)).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def write_report(
    folder: Path, runs: Mapping[str, Run], more: Mapping[str, Run], provenance: Provenance, started: float
) -> None:
    """Write report.html, report.md, report.json and figures/ to `folder`.

    Args:
        runs: at the published sizes.
        more: those of them whose verdicts need more trials, with as many; the cells that do are judged anew.
    """
    cells, tested, fit, judged_points = compare(runs), claims(runs), calibration(), points()
    judged, at_size = not provenance.quick, {cell.name: cell for cell in cells}
    again = [cell for cell in compare(more) if enough([at_size[cell.name]])]
    (folder / "figures").mkdir(parents=True)
    context: dict[str, Any] = {
        "rows": [row(cell) for cell in cells],
        "again": [row(cell) for cell in again],
        "judged": judged,
        "tally": tally(cells),
        "rule": RULE,
        "claims": [claim_row(claim) for claim in tested],
        "sections": SECTIONS,
        "pictures": _pictures(folder / "figures", runs),
        "food_after_escape": food_after_escape(runs),
        "fit": fit,
        "searched": sum(point.of == "search" for point in judged_points),
        "finalists": [point for point in judged_points if point.of == "finalists"],
        "near": len(within_noise(judged_points)) if judged_points else 0,
        "pins": pins(judged_points) if judged_points else [],
        "unit": UNIT,
        "provenance": provenance,
        "runs": [_run_row(name, run) for name, run in (*runs.items(), *more.items())],
        "wall_s": time.perf_counter() - started,
    }
    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=jinja2.select_autoescape(("html",)), trim_blocks=True
    )
    for name in ("report.html", "report.md"):
        write(folder / name, templates.get_template(f"{name}.j2").render(context))
    write_json(
        folder / "report.json",
        {
            "rule": RULE,
            "cells": [cell.to_json(judged) for cell in cells],
            "cells_with_enough_trials": [cell.to_json(judged) for cell in again],
            "claims": [_claim_json(claim, judged) for claim in tested],
            "calibration": fit,
            "provenance": asdict(provenance) | {"wall_s": context["wall_s"]},
            "runs": {name: str(run.folder) for name, run in runs.items()},
        },
    )


def _pictures(folder: Path, runs: Mapping[str, Run]) -> dict[str, list[dict[str, str]]]:
    """Write every figure to `folder`; what the templates need of them, by section."""
    pictures: dict[str, list[dict[str, str]]] = {}
    for drawing, shape in drawings(runs):
        files = encoded(shape, 170)
        content = compressed(files[".png"])
        write(folder / f"{drawing.name}.png", content)
        write(folder / f"{drawing.name}.svg", files[".svg"])
        section = "3" if drawing.section.startswith("3") else drawing.section
        pictures.setdefault(section, []).append(
            {
                "name": drawing.name,
                "section": drawing.section,
                "caption": drawing.told(runs),
                "data": base64.b64encode(content).decode(),
            }
        )
    return pictures


def _claim_json(claim: Claim, judged: bool) -> dict[str, Any]:
    numbers = {key: finite(getattr(claim, key)) for key in ("value", "low", "high")}
    return {key: found for key, found in (asdict(claim) | numbers).items() if judged or key != "holds"}


def food_after_escape(runs: Mapping[str, Run]) -> str:
    """How many of the robots that left their orbit by learning then found food, and when on average."""
    if "orbit/learning" not in runs:
        return ""
    run = runs["orbit/learning"]
    escaped, times = np.isfinite(escapes(run)), first_food(run)
    ate = times[escaped & np.isfinite(times)]
    mean = f", after {ate.mean():.1f} s on average" if len(ate) else ""
    return f"{len(ate)} of {escaped.sum()} robots that escaped by learning found food within the trial{mean}."


def _run_row(name: str, run: Run) -> dict[str, str]:
    summary = run.summary
    return {
        "name": name,
        "size": f"{summary['trials']} x {summary['seconds']:.0f} s",
        "seed": str(summary["seed"]),
        "engine": summary["engine"],
        "wall": f"{summary['wall_s']:.1f} s",
        "content": run.folder.name.rpartition("-")[2],
    }
