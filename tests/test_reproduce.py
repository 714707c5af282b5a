"""The whole reproduction at small size, as a user runs it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from labels import faults

from snnrl.recording.runs import Run
from snnrl.thesis import fit, reproduce
from snnrl.thesis.compare import MOST, Cell, compare, enough
from snnrl.thesis.dampening import dampened
from snnrl.thesis.gallery import DRAWINGS, drawings
from snnrl.thesis.loss import UNIT
from snnrl.thesis.published import published
from snnrl.thesis.report import Provenance, write_report
from snnrl.thesis.verdicts import Sample, Share, compare_means, compare_shares


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a quick reproduction has been made."""
    folder = tmp_path_factory.mktemp("thesis")
    with pytest.MonkeyPatch.context() as patch, torch.no_grad():
        patch.chdir(folder)
        reproduce.main(["--quick", "--results", "results"])
    return folder


def report(folder: Path) -> Path:
    return max((folder / "runs" / "thesis").glob("20*"))


def test_every_published_cell_is_in_the_report(made: Path) -> None:
    content = json.loads((report(made) / "report.json").read_text())
    cells = {(cell["experiment"], cell["robot"]) for cell in content["cells"]}
    wanted = {
        (experiment, robot)
        for kind in ("food", "correct", "contrast")
        for experiment, robots in published()[kind].items()
        for robot in robots
    } | {("orbit", robot) for robot in published()["escaped"]["orbit"]}
    assert cells == wanted
    food = next(cell for cell in content["cells"] if cell["quantity"] == "food" and cell["robot"] == "benchmark")
    assert food["difference"] == pytest.approx(food["ours"]["mean"] - food["published"]["mean"])
    assert content["provenance"]["quick"] is True
    assert len(content["claims"]) == 11


def test_every_figure_keeps_the_convention(made: Path) -> None:
    names = json.loads((report(made) / "report.json").read_text())["runs"]
    with torch.no_grad():
        drawn = drawings({name: Run(made / path) for name, path in names.items()})
    assert len(drawn) > 25
    assert {drawing.name: found for drawing, shape in drawn if (found := faults(shape))} == {}


def test_a_quick_reproduction_gives_no_verdicts(made: Path) -> None:
    content = json.loads((report(made) / "report.json").read_text())
    assert not any({"verdict", "trials_needed"} & set(cell) for cell in content["cells"])
    assert not any("holds" in claim for claim in content["claims"])
    for name in ("report.md", "report.html"):
        text = (report(made) / name).read_text().rpartition("</style>")[2]
        assert "too small for verdicts" in text
        assert not re.search("equivalent|inconclusive|differs|trials needed|holds|does not hold", text)


def test_a_full_one_judges_every_cell_and_claim(made: Path, tmp_path: Path) -> None:
    quick = json.loads((report(made) / "report.json").read_text())
    runs = {name: Run(made / path) for name, path in quick["runs"].items() if name.startswith("orbit/")}
    provenance = {key: value for key, value in quick["provenance"].items() if key != "wall_s"}
    write_report(tmp_path / "full", runs, {}, Provenance(**{**provenance, "quick": False}), 0.0)
    content = json.loads((tmp_path / "full" / "report.json").read_text())
    verdicts = [cell["verdict"] for cell in content["cells"]]
    assert len(verdicts) == 4
    assert set(verdicts) <= {"inconclusive", "differs"}  # of three trials
    assert all(cell["trials_needed"] is None for cell in content["cells"] if cell["unit"] == "of trials")
    for name in ("report.md", "report.html"):
        text = (tmp_path / "full" / name).read_text()
        assert f"0 equivalent, {verdicts.count('inconclusive')} inconclusive" in text
        assert text.count("not with the published n") >= 3
    rows = [line for line in (tmp_path / "full" / "report.md").read_text().splitlines() if line.startswith("| orbit |")]
    assert [row.split(" | ")[-1] for row in rows] == [f"{verdict} |" for verdict in verdicts]


def benchmark_like(folder: Path, trials: int) -> Run:
    """A run of secondary_behaviour's benchmark, with the published mean and a wide spread."""
    food = 808.4 + 200.0 * np.where(np.arange(trials) % 2, 1.0, -1.0)
    run = Run(folder)
    run.__dict__.update(
        summary={"trials": trials, "seconds": 1.0, "seed": 0, "engine": "fused", "wall_s": 1.0},
        trials={"food": food, "correct": np.ones(trials)},
    )
    return run


def test_cells_that_need_more_trials_get_them_beside_the_published_size(made: Path, tmp_path: Path) -> None:
    few, name = benchmark_like(tmp_path, 10), "secondary_behaviour/benchmark"
    (needed,) = enough(compare({name: few})).values()
    cells = {cell.quantity: cell for cell in compare({name: few})}
    assert cells["food"].verdict == "inconclusive"
    assert needed == max(cell.difference.trials_needed for cell in cells.values() if cell.verdict == "inconclusive")
    quick = json.loads((report(made) / "report.json").read_text())
    provenance = {key: value for key, value in quick["provenance"].items() if key != "wall_s"}
    more = {name: benchmark_like(tmp_path, needed + 2)}
    write_report(tmp_path / "more", {name: few}, more, Provenance(**{**provenance, "quick": False}), 0.0)
    content = json.loads((tmp_path / "more" / "report.json").read_text())
    assert [cell["ours"]["n"] for cell in content["cells"] if cell["quantity"] == "food"] == [10]
    again = {cell["quantity"]: cell for cell in content["cells_with_enough_trials"]}
    assert again["food"]["ours"]["n"] == needed + 2
    assert again["food"]["verdict"] == "equivalent"
    text = (tmp_path / "more" / "report.md").read_text()
    assert "1 equivalent" not in text  # the tally is of the published size
    assert f"| {needed + 2} |" in text


def test_no_run_is_longer_for_a_cell_that_no_number_of_trials_would_decide() -> None:
    undecided = Share(41, 50)
    cell = Cell("a", "b", "learnt", "of trials", undecided, undecided, compare_shares(undecided, undecided))
    assert (cell.verdict, enough([cell])) == ("inconclusive", {})
    ours = Sample(100.0, 1000.0, 50)
    wide = Cell("a", "b", "food", "items", Sample(100.0, 5.0, 50), ours, compare_means(ours, Sample(100.0, 5.0, 50)))
    assert wide.difference.trials_needed > MOST
    assert enough([wide]) == {"a/b": MOST}


def test_the_page_is_one_file_with_every_figure(made: Path) -> None:
    page = (report(made) / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    drawn = {path.stem for path in (report(made) / "figures").glob("*.png")}
    optional = {"failing_trial", "coincidence_food", "coincidence_empty", "calibration", "sensitivity"}
    assert {drawing.name for drawing in DRAWINGS} - optional <= drawn
    assert page.count("<figure>") == len(drawn)


def test_the_small_form_is_complete(made: Path) -> None:
    text = (made / "results" / "README.md").read_text()
    links = re.findall(r"\]\((figures/[^)]+)\)", text)
    assert links
    assert all((made / "results" / link).exists() for link in links)


def test_the_close_up_of_dampening_shows_it(made: Path) -> None:
    content = json.loads((report(made) / "report.json").read_text())
    seen = dampened(Run(made / content["runs"]["dampening"]))
    falls = seen.falls.sum(0)
    assert falls.max() >= 1
    text = (report(made) / "report.md").read_text()
    assert f"all its weights fall by 0.1 mV (triangles: {falls.max()} times in 30 s)" in text
    row, trial = np.argwhere(seen.falls)[0]
    for half in (seen.attraction, seen.avoidance):
        assert half[row - 1, trial] - half[row, trial] == pytest.approx(0.1, abs=0.05)


def test_captions_are_of_a_quick_reproductions_lengths(made: Path) -> None:
    text = (report(made) / "report.md").read_text()
    assert "in the first 20 s of trial 0" in text
    assert "poison from 40 s on" in text
    assert not re.search(r"\b(500|1000) s\b", text.partition("## Methods")[2].partition("## Calibration")[0])


def test_the_report_says_in_which_units_the_fits_numbers_are(made: Path) -> None:
    record = fit.calibration()
    assert record is not None
    assert json.loads((report(made) / "report.json").read_text())["calibration"]["unit"] == record["unit"]
    section = (report(made) / "report.md").read_text().partition("## Calibration")[2]
    assert f"The losses and distances of that fit are in {record['unit']}" in section
    assert ("cannot be compared" in section) is (record["unit"] != UNIT)


def test_finished_runs_are_found_by_content_only(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    small = reproduce.plan(0, True, "food_attraction")[0]
    same, found = reproduce.obtain(small)
    assert found
    assert "found, same configuration" in capsys.readouterr().out
    other = reproduce.Planned(small.name, small.experiment, (*small.overrides, "coding.touch_gain=2.75"))
    changed, found = reproduce.obtain(other)
    assert not found
    assert changed.folder != same.folder
    summary = json.loads((changed.folder / "summary.json").read_text())
    (changed.folder / "summary.json").write_text(json.dumps({**summary, "complete": False}))  # as if interrupted
    assert reproduce.obtain(other) == (changed, False)
    monkeypatch.setattr(reproduce, "code_version", lambda: "another")
    assert not reproduce.obtain(small)[1]


def test_one_experiment_alone(made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(made)
    with torch.no_grad():
        reproduce.main(["--quick", "--only", "orbit"])
    assert capsys.readouterr().out.count("found, same") == 3
    content = json.loads((report(made) / "report.json").read_text())
    assert {cell["experiment"] for cell in content["cells"]} == {"orbit"}
    with pytest.raises(SystemExit):
        reproduce.main(["--only", "nothing"])
