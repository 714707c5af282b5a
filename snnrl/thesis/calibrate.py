"""Fit the free parameters to all published cells together: one set of values for every experiment.

    python -m snnrl.calibrate [--points 40] [--trials 16] [--study runs/calibration.db]
    python -m snnrl.calibrate --fix world.overlap=nearest    # search the others only
    python -m snnrl.calibrate --again 341 868 [--fix ...]    # judge points of the study anew, changed by what is fixed
    python -m snnrl.calibrate --finalists 10 --trials 50    # judge the best points again, on a seed of their own
    python -m snnrl.calibrate --sensitivity    # change the values in conf/ one at a time
    python -m snnrl.calibrate --record NOTE    # write what the study holds into the package, for the report

The loss is that of `snnrl.thesis.loss`. The study is kept in the file; running the command again continues it, and
several at once share it. A new one begins with the points that the package's record holds, if it holds any.
Seeds of the fit start at 1,000,000, far from those of the runs that are reported.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import optuna
import torch

from snnrl.errors import ConfigError
from snnrl.files import csv_of, write, write_json
from snnrl.thesis.box import FREE, STARTS, Choice, Free, present
from snnrl.thesis.fit import CALIBRATION, POINTS, calibration, points
from snnrl.thesis.loss import UNIT, loss
from snnrl.thesis.measuring import COURSE, cells_of, measured, orbits

FIRST_SEED = 1_000_000  # and one more for each point
FINAL_SEED = 2_000_000  # of all finalists
LAST = 2  # step of the last of the `rungs`
FEWER = 4  # of so many points one goes on to the next rung
CHEAP = (COURSE, ("secondary_behaviour", "container_dopamine_learning"))  # with the orbit, what most points fail
TELLING = (  # what most of the others fail
    ("secondary_behaviour", "benchmark"),
    ("secondary_behaviour", "fixed_container_dopamine"),
    ("secondary_behaviour", "no_container_dopamine"),
    ("dual_learning", "learning"),
)
STUDIES = ("calibration by rungs", "finalists", "sensitivity")
TAKEN = (optuna.trial.TrialState.COMPLETE, optuna.trial.TrialState.RUNNING)  # what needs no judging


def rungs(values: Mapping[str, Any], trials: int, seed: int) -> Iterator[dict[str, float]]:
    """What a point is judged by, each time by more: what is cheap and what tells most, by few trials; then all."""
    few = max(2, trials // 3)
    found = dict([*orbits(values, few, seed), *cells_of(CHEAP, values, few, seed)])
    yield found
    yield {**found, **dict(cells_of(TELLING, values, few, seed))}
    yield dict(measured(values, trials, seed))


def distribution(free: Free | Choice) -> optuna.distributions.BaseDistribution:
    """Where a free value is searched."""
    if isinstance(free, Choice):
        return optuna.distributions.CategoricalDistribution(free.values)
    return optuna.distributions.FloatDistribution(free.low, free.high, log=free.high > 3 * free.low > 0)


SEARCHED = {name: distribution(free) for name, free in FREE.items()}


def begin(fit: optuna.Study, finalists: optuna.Study, sensitivity: optuna.Study) -> None:
    """Give new studies what the record holds, points under their numbers; without a record STARTS come first.

    Of what was given up the record has the count alone: the sampler learns nothing from it.
    """
    if fit.trials:
        return
    if (held := calibration()) is None:
        for start in STARTS:
            fit.enqueue_trial({**present(), **start})
        return
    recorded = points()
    for point in recorded:
        values = typed(point.values)
        if point.of == "search":
            _pass_over(fit, point.number - len(fit.trials))
            fit.add_trial(
                optuna.trial.create_trial(
                    value=point.loss,
                    params=values,
                    distributions=SEARCHED,
                    user_attrs={"trials": point.trials, "distances": dict(point.distances)},
                )
            )
        else:
            _keep(finalists, point.loss, point.distances, point.trials, number=point.number, values=values)
    fit.set_user_attr("given_up", held["given_up"])
    _pass_over(fit, given_up(fit) + len(recorded) - len(finalists.trials) - len(fit.trials))
    if held["varied"] == present():
        sensitivity.set_user_attr("varied", present())
        for known in held["sensitivity"]:
            _keep(sensitivity, known["loss"], known["distances"], known["trials"], change=known["change"])


def _pass_over(study: optuna.Study, count: int) -> None:
    """So many numbers of points are taken."""
    for _ in range(count):
        study.add_trial(optuna.trial.create_trial(state=optuna.trial.TrialState.FAIL))


def _keep(study: optuna.Study, loss: float, distances: Mapping[str, float], trials: int, **attributes: Any) -> None:
    """Values that were judged outside the search."""
    attributes |= {"distances": dict(distances), "trials": trials}
    study.add_trial(optuna.trial.create_trial(value=loss, user_attrs=attributes))


def given_up(study: optuna.Study) -> int:
    """How many points of a search not all cells have judged."""
    return len(study.get_trials(states=[optuna.trial.TrialState.PRUNED])) + study.user_attrs.get("given_up", 0)


def typed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Free values as the box has them, from how a record or a command line writes them.

    Raises:
        ConfigError: a value that is not free, or not one that is searched.
    """
    return {name: _typed(name, value) for name, value in values.items()}


def _typed(name: str, value: Any) -> Any:
    if name not in FREE:
        raise ConfigError(name, value, f"is not free; must be one of {', '.join(FREE)}")
    free = FREE[name]
    if isinstance(free, Choice):
        for choice in free.values:
            if _text(value) in (_text(choice), str(choice)):
                return choice
        raise ConfigError(name, value, f"must be one of {', '.join(map(_text, free.values))}")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not free.low <= number <= free.high:
        raise ConfigError(name, value, f"must be a number from {free.low:g} to {free.high:g}")
    return number


def search(study: optuna.Study, points: int, trials: int, fixed: dict[str, Any] | None = None) -> None:
    """Add points to the study; of each FEWER that come to a rung, the best goes on to the next."""
    study.sampler = optuna.samplers.TPESampler(
        seed=FIRST_SEED + len(study.trials), multivariate=True, constant_liar=True
    )
    study.pruner = optuna.pruners.SuccessiveHalvingPruner(min_resource=1, reduction_factor=FEWER)
    for _ in range(points):
        if fixed:
            study.enqueue_trial(fixed)
        _judge(study, study.ask(SEARCHED), trials)


def again(study: optuna.Study, numbers: Sequence[int], trials: int, fixed: Mapping[str, Any]) -> None:
    """Have every cell judge points of the study, with what is fixed in place of their own values: as further points.

    Raises:
        ConfigError: a number that no such point has.
    """
    known = {trial.number: trial.params for trial in study.trials if trial.params}
    for number in numbers:
        if number not in known:
            raise ConfigError("--again", number, "must be the number of a point whose values the study has")
    study.pruner = optuna.pruners.NopPruner()
    for number in numbers:
        study.enqueue_trial({**known[number], **fixed})
        _judge(study, study.ask(SEARCHED), trials)


def _judge(study: optuna.Study, trial: optuna.Trial, trials: int) -> None:
    trial.set_user_attr("trials", trials)
    found: dict[str, float] = {}
    try:
        for step, found in enumerate(rungs(trial.params, trials, FIRST_SEED + trial.number)):
            trial.set_user_attr("distances", found)
            trial.report(loss(found), FEWER**step)
            if step < LAST and trial.should_prune():
                study.tell(trial, state=optuna.trial.TrialState.PRUNED)
                return
    except BaseException:
        study.tell(trial, state=optuna.trial.TrialState.FAIL)  # else it would count as still being judged
        raise
    study.tell(trial, loss(found))
    print(f"{loss(found):.2f}  point {trial.number}", flush=True)


def neighbours(values: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Every change of one value: a step down and up where that is searched too, or another choice."""
    result: list[tuple[str, Any]] = []
    for name, free in FREE.items():
        if isinstance(free, Free):
            around = (round(values[name] - free.step, 6), round(values[name] + free.step, 6))
            result += [(name, value) for value in around if free.low <= value <= free.high]
        else:
            result += [(name, value) for value in free.values if value != values[name]]
    return result


def vary(study: optuna.Study, trials: int) -> None:
    """Evaluate the values in conf/ and all their neighbours, on the same seed; what is there already is kept.

    Raises:
        ConfigError: what is there is of other values.
    """
    values = present()
    if study.trials and study.user_attrs.get("varied") != values:
        raise ConfigError(
            "--sensitivity", True, "the study has that of other values than conf/; --study must be another"
        )
    study.set_user_attr("varied", values)
    for name, value in [("", None), *neighbours(values)]:
        change, called = [name, value], f"{name} {value}" if name else "conf/"
        if taken(study, "change", change, called):
            continue
        changed = {**values, **({name: value} if name else {})}
        found = judge(study, {"change": change}, changed, trials, FIRST_SEED - 1)
        print(f"{found:.2f}  {called}", flush=True)


def best_of(study: optuna.Study, count: int) -> list[optuna.trial.FrozenTrial]:
    """The points that every cell has judged, those of the least loss, the best first."""
    complete = study.get_trials(states=[optuna.trial.TrialState.COMPLETE])
    return sorted(complete, key=lambda trial: float(trial.value or 0.0))[:count]


def judge_again(fit: optuna.Study, finalists: optuna.Study, count: int, trials: int) -> None:
    """Judge the best points of a search once more, all on one seed that it has not used; what is there is kept."""
    for point in best_of(fit, count):
        if taken(finalists, "number", point.number, f"point {point.number}"):
            continue
        found = judge(finalists, {"number": point.number, "values": point.params}, point.params, trials, FINAL_SEED)
        print(f"{found:.2f}  point {point.number}, {point.value:.2f} in the search", flush=True)


def taken(study: optuna.Study, key: str, value: Any, called: str) -> bool:
    """Whether a study has what an attribute says, or another process is judging it."""
    states = {trial.state for trial in study.get_trials(states=TAKEN) if trial.user_attrs.get(key) == value}
    if states == {optuna.trial.TrialState.RUNNING}:
        print(f"{called}: left to another process, or to one that was killed at it", flush=True)
    return bool(states)


def judge(study: optuna.Study, told: Mapping[str, Any], values: Mapping[str, Any], trials: int, seed: int) -> float:
    """Judge values by all cells outside of a search, so that no other process does; returns the loss."""
    trial = study.ask()
    for key, value in told.items():
        trial.set_user_attr(key, value)
    try:
        found = dict(measured(values, trials, seed))
    except BaseException:
        study.tell(trial, state=optuna.trial.TrialState.FAIL)
        raise
    trial.set_user_attr("distances", found)
    trial.set_user_attr("trials", trials)
    study.tell(trial, loss(found))
    return loss(found)


def record(fit: optuna.Study, sensitivity: optuna.Study, note: str) -> dict[str, Any]:
    """What the report says of a search, and what there is to say of it.

    A sensitivity that has not been tried in the study is that of the former record, with the values that it is of.
    """
    finished = best_of(fit, len(fit.trials))
    varied = {
        "varied": sensitivity.user_attrs.get("varied"),
        "sensitivity": [
            {"loss": trial.value, **trial.user_attrs}
            for trial in sensitivity.get_trials(states=[optuna.trial.TrialState.COMPLETE])
        ],
    }
    former = calibration() or varied
    return {
        "values": present(),
        "note": note,
        "unit": UNIT,
        "first_seed": FIRST_SEED,
        "final_seed": FINAL_SEED,
        "given_up": given_up(fit),
        "trials": sorted({trial.user_attrs["trials"] for trial in finished}),
        **(varied if sensitivity.trials else {key: former[key] for key in varied}),
    }


def points_of(fit: optuna.Study, finalists: optuna.Study) -> str:
    """Every point that all cells have judged as CSV, in the search and as a finalist: values, loss, distances."""
    judged = [
        ("search", trial.number, trial.user_attrs["trials"], trial.value, trial.params, trial.user_attrs["distances"])
        for trial in sorted(best_of(fit, len(fit.trials)), key=lambda trial: trial.number)
    ]
    judged += [
        (
            "finalists",
            *(trial.user_attrs[key] for key in ("number", "trials")),
            trial.value,
            *(trial.user_attrs[key] for key in ("values", "distances")),
        )
        for trial in finalists.get_trials(states=[optuna.trial.TrialState.COMPLETE])
    ]
    cells = sorted({cell for *_, distances in judged for cell in distances})
    rows = [
        [
            kind,
            number,
            trials,
            f"{value:.4g}",
            *map(_text, (values.get(name) for name in FREE)),
            *(f"{distances[cell]:.3g}" if cell in distances else None for cell in cells),
        ]
        for kind, number, trials, value, values, distances in judged
    ]
    return csv_of(["of", "number", "trials", "loss", *FREE, *cells], rows)


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--points", type=int, default=40, help="points to add to the study")
    made.add_argument("--trials", type=int, default=16, help="trials a cell and point")
    made.add_argument("--study", type=Path, default=Path("runs/calibration.db"))
    made.add_argument("--fix", nargs="+", default=[], metavar="KEY=VALUE", help="free values that are not searched")
    made.add_argument("--again", nargs="+", type=int, metavar="NUMBER", help="judge points of the study anew instead")
    made.add_argument("--finalists", type=int, metavar="N", help="judge the N best points again instead")
    made.add_argument("--sensitivity", action="store_true", help="vary the values in conf/ one at a time instead")
    made.add_argument(
        "--record",
        metavar="NOTE",
        help=f"write the studies, and a note, to {CALIBRATION.name} and {POINTS.name} instead",
    )
    return made


@torch.no_grad()
def main(words: Sequence[str] | None = None) -> None:
    try:
        perform(parser().parse_args(words))
    except ConfigError as error:
        print(f"snnrl.calibrate: {error}", file=sys.stderr)
        sys.exit(2)


def perform(arguments: argparse.Namespace) -> None:
    fixed = typed(dict(word.partition("=")[::2] for word in arguments.fix))
    arguments.study.parent.mkdir(parents=True, exist_ok=True)
    fit, finalists, sensitivity = (
        optuna.create_study(storage=f"sqlite:///{arguments.study}", study_name=name, load_if_exists=True)
        for name in STUDIES
    )
    begin(fit, finalists, sensitivity)
    if arguments.again:
        again(fit, arguments.again, arguments.trials, fixed)
    elif arguments.record is not None:
        write_json(CALIBRATION, record(fit, sensitivity, arguments.record))
        write(POINTS, points_of(fit, finalists))
    elif arguments.finalists:
        judge_again(fit, finalists, arguments.finalists, arguments.trials)
    elif arguments.sensitivity:
        vary(sensitivity, arguments.trials)
    else:
        search(fit, arguments.points, arguments.trials, fixed)
        print(f"best of {len(fit.trials)}: {fit.best_value:.2f}")
        for name, value in fit.best_params.items():
            print(f"  {name}: {value}")
        for name, value in sorted(fit.best_trial.user_attrs["distances"].items()):
            print(f"  {value:+6.1f}  {name}")
