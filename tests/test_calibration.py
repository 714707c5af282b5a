"""The search for the free values: what it starts from, measures, records and gives up."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
import torch
import yaml
from helpers import compose_config

from snnrl.configuration.builder import build
from snnrl.errors import ConfigError
from snnrl.recording.runs import Run
from snnrl.running.job import perform
from snnrl.thesis import calibrate, fit, measuring
from snnrl.thesis.box import FREE, KICK, OWN_MEAN, STARTS, Choice, present
from snnrl.thesis.calibrate import neighbours
from snnrl.thesis.claims import settled, taxis
from snnrl.thesis.compare import contrast
from snnrl.thesis.loss import UNIT, Outcome
from snnrl.thesis.measuring import mean_weights, outcome, prepare, simulate
from snnrl.thesis.published import PUBLISHED
from snnrl.thesis.search import search


def test_the_study_starts_from_the_values_in_conf() -> None:
    values = present()
    assert set(values) == set(FREE)
    coding = compose_config("+experiment=food_attraction").coding
    assert coding is not None
    assert values["coding.range_gain"] == coding.range_gain


def test_every_published_cell_is_an_experiment_with_that_robot() -> None:
    published = yaml.safe_load(PUBLISHED.read_text())
    for kind in ("food", "correct", "contrast", "failed_weakly"):
        for experiment, robots in published[kind].items():
            config = compose_config(f"+experiment={experiment}")
            assert set(robots) <= set(config.experiment.robots)
            assert config.trials == published["trials"]
            if kind == "correct":
                assert config.experiment.correct


def test_every_published_number_is_a_cell_of_the_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    few = np.array([3.0, 4.0])
    stub = Outcome(few, few, few > 3, few > 3, np.stack([few, few]))
    course = replace(stub, saturated=few, settled=few)
    monkeypatch.setattr(measuring, "outcome", lambda *run: course if run[:2] == measuring.COURSE else stub)
    for name in ("escape_times", "background_rate", "dose", "waits"):
        monkeypatch.setattr(measuring, name, lambda *_: torch.from_numpy(few))
    published = yaml.safe_load(PUBLISHED.read_text())
    expected = {"background rate", "dose", "entering to food", "orbit/learning/time"}
    expected |= {f"food_attraction/learning/{when}" for when in ("weights saturated", "attraction settled")}
    expected |= {f"orbit/{robot}/escaped" for robot in published["escaped"]["orbit"]}
    for kind, quantities in (
        ("food", ("food", "food spread", "trapped")),
        ("correct", ("correct",)),
        ("contrast", ("contrast",)),
        ("failed_weakly", ("failed weakly",)),
    ):
        robots = [f"{experiment}/{robot}" for experiment, robots in published[kind].items() for robot in robots]
        expected |= {f"{robot}/{quantity}" for robot in robots for quantity in quantities}
    found = list(measuring.measured({}, 2, 0))
    assert sorted(name for name, _ in found) == sorted(expected)


def test_late_food_is_that_of_the_last_part_of_a_trial() -> None:
    robot, seed = ("food_attraction", "learning"), 3
    ours = outcome(*robot, {"seconds": 35.0}, 4, seed)
    until, _ = simulate(*robot, {"seconds": 24.5}, 4, seed)
    assert ours.late.sum() > 0
    assert (ours.food - ours.late).tolist() == until.situation.world.touches[:, 0].tolist()
    assert ours.contrast is None


def test_a_course_is_that_of_the_recorded_series(tmp_path: Path) -> None:
    """The same definitions as those of the claims, on the same samples."""
    ours = outcome("food_attraction", "learning", {"seconds": 200.0}, 3, 5)
    words = ("robot=learning", "seconds=200", "trials=3", "seed=5", "record.tensorboard=false")
    perform(compose_config("+experiment=food_attraction", *words), tmp_path)
    run = Run(tmp_path)
    assert len(run.time) == 10
    assert ours.saturated is not None
    assert ours.settled is not None
    assert ours.saturated == pytest.approx(settled(run.time, taxis(run, "weight", "food", "attraction")))
    ms = np.diff([0, *np.round(1000 * run.time)])[:, None]
    items = np.round(ms / 1000 * run.series["collection_rate"])  # whole again: rounding must break no tie
    assert ours.settled == pytest.approx(settled(run.time, items / (ms / 1000)))
    assert (ours.settled >= 20.0).all()
    other = outcome("food_attraction", "random_walk", {"seconds": 70.0}, 2, 5)
    assert (other.saturated, other.attraction) == (None, None)


def test_attraction_of_containers_is_that_of_each_side() -> None:
    ours = outcome("secondary_behaviour", "benchmark", {"seconds": 1.4}, 3, 5)
    network = build(compose_config("+experiment=secondary_behaviour", "robot=benchmark", "trials=3", "seed=5")).network
    sides = ("left_container_to_right_motor", "right_container_to_left_motor")
    assert ours.attraction is not None
    assert ours.attraction.tolist() == [network.projections[name].mean_weight().tolist() for name in sides]


def test_the_dose_is_what_counted_spikes_release_by_item() -> None:
    """Without a threshold all spikes count, with one that is too high none; and it is proportional to the release."""
    fixed = {"world.kinds.food.count": 60, "network.dopamine.threshold": 0}
    simulation, _ = simulate("food_attraction", "random_walk", {**fixed, "seconds": 40.04}, 2, 7)
    spikes = int(simulation.network.spike_count[:, list(simulation.network.groups).index("dopaminergic")].sum())
    items = int(simulation.situation.world.touches[:, 0].sum())
    assert items > 20
    found = float(measuring.dose(fixed, 2, 7, 40.0))
    assert found == pytest.approx(0.0035 * spikes / items)
    doubled = {**fixed, "network.dopamine.release": 0.007}
    assert float(measuring.dose(doubled, 2, 7, 40.0)) == pytest.approx(2 * found)
    assert float(measuring.dose({**fixed, "network.dopamine.threshold": 41}, 2, 7, 40.0)) == 0.0
    usual = float(measuring.dose({"world.kinds.food.count": 60}, 2, 7, 40.0))
    assert 0.0 < usual < found
    assert len(measuring.dose({"world.kinds.food.count": 0}, 1, 7, 20.0)) == 0


class Scripted:
    """A simulation of three trials of which only the counts of two kinds are known, by tick."""

    tick = 70

    def __init__(self, **counts: list[list[int]]) -> None:
        self.counts, self.done = counts, 0
        self.situation = self.world = self

    def run(self, engine: object, ticks: int) -> None:
        self.done += ticks

    def count(self, kind: str) -> torch.Tensor:
        return torch.tensor([trial[self.done] for trial in self.counts[kind]])


def test_a_wait_is_from_the_last_entering_to_the_food(monkeypatch: pytest.MonkeyPatch) -> None:
    """One waits three ticks, one leaves and enters again and takes at once, one takes nothing."""
    entered = [[0, 0, 1, 1, 1, 1, 1], [0, 1, 1, 1, 2, 2, 2], [0, 0, 0, 1, 1, 1, 1]]
    taken = [[0, 0, 0, 0, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1], [0, 0, 0, 0, 0, 0, 0]]
    simulation = Scripted(food_container=entered, food=taken)
    monkeypatch.setattr(measuring, "prepare", lambda *_: (simulation, None, None))
    assert measuring.waits({}, 3, 0, seconds=0.42).tolist() == pytest.approx([0.0, 0.21])


def test_contrast_of_the_two_container_touches() -> None:
    run = build(compose_config("+experiment=secondary_stimulus", "trials=2"))
    for kind, weights in (("food", (2.0, 2.0)), ("empty", (0.4, 0.6))):
        projection = run.network.projections[f"{kind}_container_touch_to_dopaminergic"]
        for trial, weight in enumerate(weights):
            mine = projection.trial == trial
            projection.weight[mine] = weight * 800 / int(mine.sum())
    assert contrast(mean_weights(run.network), 4.0).tolist() == [True, False]
    assert contrast(mean_weights(run.network), 1.0).tolist() == [True, True]


def test_neighbours_change_one_value_each() -> None:
    values = present()
    changes = neighbours(values)
    assert {name for name, _ in changes} == set(FREE)
    assert len(changes) == len(set(changes)) > len(FREE)
    for name, value in changes:
        free = FREE[name]
        assert value != values[name]
        assert value in free.values if isinstance(free, Choice) else free.low <= value <= free.high
        outcome("secondary_behaviour", "benchmark", {**values, name: value, "seconds": 0.7}, 2, 0)


def test_every_start_can_be_run() -> None:
    for start in STARTS:
        assert start.keys() <= FREE.keys()
        for name, value in start.items():
            free = FREE[name]
            assert value in free.values if isinstance(free, Choice) else free.low <= value <= free.high
        for run in (("food_attraction", "learning"), ("secondary_behaviour", "fixed_container_dopamine")):
            outcome(*run, {**present(), **start, "seconds": 0.7}, 2, 0)


def test_kicks_come_with_their_rate_and_arrival_with_what_it_needs() -> None:
    values = {"network.groups.dopaminergic.kick_rate": 0.4, "network.plasticity.potentiation_from": "arrival"}
    network = prepare("food_attraction", "learning", values, 1, 0)[1].network
    assert network.groups["dopaminergic"].kick == KICK["network.groups.dopaminergic.kick"]
    assert network.plasticity.simultaneous == "depresses"
    assert prepare("food_attraction", "learning", {}, 1, 0)[1].network.groups["dopaminergic"].kick == 0.0
    without = prepare("food_attraction", "learning", {"world.ranges.container.measured_to": "border"}, 1, 0)[1].world
    assert without is not None
    assert "container" not in without.ranges


@pytest.fixture
def no_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as nothing has been fitted."""
    monkeypatch.setattr(fit, "POINTS", tmp_path / "none.csv")
    monkeypatch.setattr(fit, "CALIBRATION", tmp_path / "none.json")


@pytest.mark.usefixtures("no_record")
def test_of_four_points_the_best_goes_on_to_the_next_rung(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, int]] = []

    def rungs(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[dict[str, float]]:
        number = seed - calibrate.FIRST_SEED
        for rung in range(3):
            seen.append((number, rung))
            yield {"a": (0.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0)[number], "b": 0.0}

    monkeypatch.setattr(calibrate, "rungs", rungs)
    study = optuna.create_study()
    calibrate.begin(study, optuna.create_study(), optuna.create_study())
    calibrate.search(study, 7, trials=5)
    assert [rung for number, rung in seen if number == 0] == [0, 1, 2]
    assert {number for number, rung in seen if rung > 0} == {0}  # the last is among the best two, but not the best
    assert study.trials[0].params == present()
    complete = len(study.get_trials(states=[optuna.trial.TrialState.COMPLETE]))
    finalists = optuna.create_study()
    made = calibrate.record(study, optuna.create_study(), "a note")
    assert (made["given_up"], made["trials"], made["unit"]) == (7 - complete, [5], UNIT)
    assert 0 < complete < 7
    assert study.best_trial.user_attrs["distances"] == {"a": 0.0, "b": 0.0}
    assert calibrate.points_of(study, finalists).count("\n") == 1 + complete


def test_finalists_are_judged_once_more_on_a_seed_of_their_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study, finalists = optuna.create_study(), optuna.create_study()
    for k, value in enumerate((3.0, 1.0, 2.0)):
        attributes = {"trials": 5, "distances": {"a b": value, "dose": 0.0}}
        free: dict[str, Any] = {"coding.range_gain": optuna.distributions.FloatDistribution(1.0, 3.5)}
        study.add_trial(
            optuna.trial.create_trial(
                value=value, params={"coding.range_gain": 1.0 + k}, distributions=free, user_attrs=attributes
            )
        )
    seen: list[tuple[float, int, int]] = []

    def measured(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[tuple[str, float]]:
        seen.append((values["coding.range_gain"], trials, seed))
        if len(seen) == 1:
            raise KeyboardInterrupt
        if len(seen) == 2:  # a second process, meanwhile, takes the next
            calibrate.judge_again(study, finalists, 2, trials=50)
        yield from (("a b", 2.0), ("dose", 0.0))

    monkeypatch.setattr(calibrate, "measured", measured)
    with pytest.raises(KeyboardInterrupt):
        calibrate.judge_again(study, finalists, 2, trials=50)
    calibrate.judge_again(study, finalists, 2, trials=50)
    calibrate.judge_again(study, finalists, 2, trials=50)
    assert seen == [(gain, 50, calibrate.FINAL_SEED) for gain in (2.0, 2.0, 3.0)]
    assert capsys.readouterr().out.count("point 1: left to another process") == 1
    rows = calibrate.points_of(study, finalists).splitlines()
    assert [row.split(",")[:3] for row in rows[1:]] == [
        ["search", "0", "5"],
        ["search", "1", "5"],
        ["search", "2", "5"],
        ["finalists", "1", "50"],
        ["finalists", "2", "50"],
    ]


def test_a_new_study_goes_on_from_the_record() -> None:
    """What it holds is recorded as it was, and what it adds has numbers, and so seeds, that none had before."""
    fits, finalists, sensitivity = (optuna.create_study() for _ in calibrate.STUDIES)
    for _ in range(2):  # a study that is there is left as it is
        calibrate.begin(fits, finalists, sensitivity)
    assert calibrate.points_of(fits, finalists) == fit.POINTS.read_text()
    held = json.loads(fit.CALIBRATION.read_text())
    assert calibrate.record(fits, sensitivity, held["note"]) == held
    assert fits.ask(calibrate.SEARCHED).number >= held["given_up"] + len([p for p in fit.points() if p.of == "search"])


def test_what_is_fixed_is_not_searched_and_points_can_be_judged_anew_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Mapping[str, Any]] = []

    def rungs(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[dict[str, float]]:
        for rung in range(3):
            seen.append({**values, "rung": rung})
            yield {"a": float(len(seen))}  # each worse than all before

    monkeypatch.setattr(calibrate, "rungs", rungs)
    study = optuna.create_study()
    fixed = calibrate.typed({"world.overlap": "nearest", "coding.range_gain": "1.5", OWN_MEAN: "None"})
    assert fixed == {"world.overlap": "nearest", "coding.range_gain": 1.5, OWN_MEAN: None}
    current = "network.groups.inhibitory.current"
    assert calibrate.typed({current: "0"}) == calibrate.typed({current: "0.0"}) == {current: 0.0}
    calibrate.search(study, 12, trials=5, fixed=fixed)
    assert all(values[name] == value for values in seen for name, value in fixed.items())
    assert len({values["coding.touch_gain"] for values in seen}) == 12
    seen.clear()
    calibrate.again(study, [3, 5], 5, {"coding.range_gain": 2.5})
    assert [values["rung"] for values in seen] == [0, 1, 2, 0, 1, 2]
    for number, values in ((3, seen[0]), (5, seen[3])):
        assert values == {**study.trials[number].params, "coding.range_gain": 2.5, "rung": 0}


@pytest.mark.parametrize(
    ("word", "line"),
    [
        ("coding.no_gain=1", "coding.no_gain=1: is not free; must be one of coding.range_gain, "),
        ("world.overlap=goes", "world.overlap=goes: must be one of stays, nearest"),
        ("coding.range_gain=9", "coding.range_gain=9: must be a number from 1 to 3.5"),
        ("coding.range_gain=", "coding.range_gain=: must be a number from 1 to 3.5"),
    ],
)
def test_what_cannot_be_fixed_is_refused(
    word: str, line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        calibrate.main(["--study", str(tmp_path / "study.db"), "--fix", word])
    assert left.value.code == 2
    assert capsys.readouterr().err.startswith(f"snnrl.calibrate: {line}")
    assert not list(tmp_path.iterdir())


def test_the_sensitivity_is_of_the_values_that_it_was_tried_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values of conf/ that have changed since are not taken for those; a record keeps which they were."""
    held = json.loads(fit.CALIBRATION.read_text())
    fits, finalists, sensitivity = (optuna.create_study() for _ in calibrate.STUDIES)
    monkeypatch.setattr(calibrate, "points", lambda: [])
    monkeypatch.setattr(calibrate, "present", lambda: {**held["varied"], "coding.range_gain": 9.0})
    calibrate.begin(fits, finalists, sensitivity)
    assert not sensitivity.trials
    kept = calibrate.record(fits, sensitivity, "")
    assert (kept["varied"], kept["sensitivity"]) == (held["varied"], held["sensitivity"])
    fits, finalists, sensitivity = (optuna.create_study() for _ in calibrate.STUDIES)
    monkeypatch.setattr(calibrate, "present", lambda: held["varied"])
    calibrate.begin(fits, finalists, sensitivity)
    assert calibrate.record(fits, sensitivity, "")["sensitivity"] == held["sensitivity"]
    monkeypatch.setattr(calibrate, "neighbours", lambda values: [])
    calibrate.vary(sensitivity, 2)  # nothing is left to do
    assert len(sensitivity.trials) == len(held["sensitivity"])
    monkeypatch.setattr(calibrate, "present", lambda: {**held["varied"], "coding.range_gain": 9.0})
    with pytest.raises(ConfigError, match="--sensitivity=True: the study has that of other values than conf/"):
        calibrate.vary(sensitivity, 2)


def test_several_processes_share_a_sensitivity(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study, seen = optuna.create_study(), list[float]()

    def measured(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[tuple[str, float]]:
        seen.append(values["coding.range_gain"])
        if len(seen) == 1:
            raise KeyboardInterrupt
        if len(seen) == 2:  # a second process, meanwhile, takes the next
            calibrate.vary(study, 12)
        yield "a b", float(len(seen))

    monkeypatch.setattr(calibrate, "measured", measured)
    monkeypatch.setattr(calibrate, "present", lambda: {"coding.range_gain": 3.0})
    monkeypatch.setattr(calibrate, "neighbours", lambda values: [("coding.range_gain", 2.0)])
    with pytest.raises(KeyboardInterrupt):
        calibrate.vary(study, 12)
    assert [trial.state.name for trial in study.trials] == ["FAIL"]
    for _ in range(2):
        calibrate.vary(study, 12)
    assert seen == [3.0, 3.0, 2.0]
    assert capsys.readouterr().out.count("conf/: left to another process") == 1
    held = calibrate.record(optuna.create_study(), study, "")["sensitivity"]
    assert [(known["change"], known["distances"]) for known in held] == [
        (["", None], {"a b": 3.0}),
        (["coding.range_gain", 2.0], {"a b": 3.0}),
    ]


def test_a_point_that_is_interrupted_is_not_left_as_being_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    def rungs(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[dict[str, float]]:
        yield {"a": 1.0}
        raise KeyboardInterrupt

    monkeypatch.setattr(calibrate, "rungs", rungs)
    study = optuna.create_study()
    with pytest.raises(KeyboardInterrupt):
        calibrate.search(study, 2, trials=5)
    assert [trial.state.name for trial in study.trials] == ["FAIL"]


def test_only_points_that_are_known_can_be_judged_anew() -> None:
    with pytest.raises(ConfigError, match="--again=3: must be the number of a point whose values the study has"):
        calibrate.again(optuna.create_study(), [3], 2, {})


def recorded(losses: Mapping[str, list[float]], gains: list[float]) -> str:
    """A record of points of the search and finalists that differ in one free value."""
    lines = [
        "of,number,trials,loss,coding.exploration_gain,world.overlap,dose,food_attraction/learning/food,dual_learning/learning/correct"
    ]
    for of, values in losses.items():
        lines += [
            f"{of},{k},5,{loss},{gain},{'stays' if k % 2 else 'nearest'},{loss},{k},{-k}"
            for k, (loss, gain) in enumerate(zip(values, gains, strict=False))
        ]
    return "\n".join(lines)


def test_values_are_pinned_as_far_as_noise_allows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Losses of the same values differ with an SD of 0.1, so that what is 0.2 from the best is not told from it."""
    monkeypatch.setattr(fit, "POINTS", tmp_path / "points.csv")
    assert fit.points() == []
    losses = {"search": [1.0, 1.15, 1.3, 2.0], "finalists": [1.1, 1.15, 1.2]}
    fit.POINTS.write_text(recorded(losses, [1.0, 1.2, 1.4, 2.0]))
    found = fit.points()
    assert fit.noise(found) == pytest.approx(0.1)
    assert [point.number for point in fit.within_noise(found)] == [0, 1]
    gain, overlap = fit.pins(found)
    assert gain == {"key": "coding.exploration_gain", "near": "1 to 1.2", "least": ""}
    assert overlap["near"] == "nearest, stays"
    assert overlap["least"] == "nearest 1.00 of 2; stays 1.15 of 2"
    for draw in (fit.history, fit.pinned, fit.fronts):
        assert draw({}) is not None
    fit.POINTS.write_text(recorded({"search": [1.0, 1.15]}, [1.0, 1.2]))
    assert fit.within_noise(fit.points()) == []  # how much losses change by chance is not known
    assert [pin["key"] for pin in fit.pins(fit.points())] == ["world.overlap"]  # whose choices can be told all the same
    assert fit.pinned({}) is not None


@pytest.mark.parametrize(
    "run",
    [
        "secondary_behaviour/container_dopamine_learning",
        "secondary_behaviour/no_container_dopamine",
        "secondary_behaviour/fixed_container_dopamine",
        "dual_learning/learning",
    ],
)
def test_every_robot_that_learns_containers_is_on_the_front(run: str) -> None:
    point = fit.Point("search", 0, 5, 1.0, {}, {f"{run}/correct": 2.0, "food_attraction/learning/food": 1.0})
    _, food, _, containers = fit.FRONTS[0]
    assert (fit.rms(point, food), fit.rms(point, containers)) == (1.0, 2.0)


def test_a_front_is_what_nothing_beats_in_both() -> None:
    assert fit.front([(1.0, 5.0), (2.0, 2.0), (3.0, 3.0), (4.0, 1.0), (1.0, 6.0)]) == [0, 1, 3]


def test_each_rung_judges_by_more(monkeypatch: pytest.MonkeyPatch) -> None:
    few = np.array([3.0, 4.0])
    seen: list[tuple[str, str, int]] = []

    def ran(experiment: str, robot: str, values: Any, trials: int, seed: int) -> Outcome:
        seen.append((experiment, robot, trials))
        return Outcome(few, few, few > 3, few > 3, np.stack([few, few]), few, few)

    monkeypatch.setattr(measuring, "outcome", ran)
    for name in ("escape_times", "background_rate", "dose", "waits"):
        monkeypatch.setattr(measuring, name, lambda *_: torch.from_numpy(few))
    rungs = list(calibrate.rungs({}, 15, 0))
    assert len(rungs) == calibrate.LAST + 1
    names = [set(rung) for rung in rungs]
    assert names[0] < names[1] < names[2]
    assert {f"orbit/{robot}/escaped" for robot in ("learning", "learning_disabled", "positive_baseline")} < names[0]
    early = [*calibrate.CHEAP, *calibrate.TELLING]
    assert seen[: len(early)] == [(*run, 5) for run in early]
    assert {trials for *_, trials in seen[len(early) :]} == {15}


def own_sets(experiment: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    homeostasis = prepare(experiment, "learning", values, 1, 0)[1].network.homeostasis
    assert homeostasis is not None
    return homeostasis.per_set


def test_the_dopamine_set_has_a_mean_of_its_own_where_there_is_one() -> None:
    values = {OWN_MEAN: False, "network.homeostasis.count_absent": True}
    own = own_sets("secondary_stimulus", values)
    assert own["container_dopamine"].count_absent is False
    assert own_sets("food_attraction", values) == own_sets("secondary_stimulus", {OWN_MEAN: None}) == {}


def test_the_record_of_a_former_fit_says_that_it_is_in_standard_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "CALIBRATION", tmp_path / "record.json")
    assert fit.calibration() is None
    point = {"loss": 2.0, "change": ["", None], "distances": {"a": 1.0}}
    changed = {"loss": 3.0, "change": ["coding.range_gain", 1.8], "distances": {"a": 2.0}}
    for unit, record in (("standard errors", {}), (UNIT, {"unit": UNIT})):
        content = {**record, "sensitivity": [point, changed]}
        (tmp_path / "record.json").write_text(json.dumps(content))
        found = fit.calibration()
        assert found is not None
        assert found["unit"] == unit
        drawn = fit.sensitivity({})
        assert drawn is not None
        labels = [axis.get_ylabel() for axis in drawn.axes]
        assert any(label.endswith(f"({unit})") for label in labels), labels


def test_an_interrupted_search_continues(tmp_path: Path) -> None:
    def study() -> optuna.Study:
        storage = f"sqlite:///{tmp_path / 'search.db'}"
        return optuna.create_study(storage=storage, study_name="s", direction="maximize", load_if_exists=True)

    options = {"seconds": 3.5}
    search(study(), 2, 2, options)
    search(study(), 1, 2, options)
    found = study().trials
    assert [trial.number for trial in found] == [0, 1, 2]
    assert found[0].params == {"potentiation": 0.1, "depression": 0.15, "tau_plus": 20.0, "tau_minus": 110.0}
    assert all(trial.value == sum(trial.user_attrs["food"]) / 2 for trial in found)
