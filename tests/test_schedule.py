"""What is due when, by hand."""

from __future__ import annotations

import pytest
from helpers import compose_config

from snnrl.recording.film import spacing
from snnrl.running.schedule import NEVER, Every, Schedule, ticks_of

TICK = 70  # ms


def schedule(*overrides: str, shown: bool = True) -> Schedule:
    return Schedule(compose_config("+experiment=food_attraction", *overrides), TICK, shown)


def walk(plan: Schedule, pace: int = 1000) -> list[int]:
    """The ticks after which a run stops that goes at most so many at once."""
    stops = [0]
    while stops[-1] < plan.end:
        stops.append(stops[-1] + min(pace, plan.left(stops[-1])))
    return stops[1:]


def test_intervals_are_whole_ticks_and_at_least_one() -> None:
    assert [ticks_of(seconds, TICK) for seconds in (None, 0.0, 0.01, 0.7, 0.74, 0.736)] == [0, 0, 1, 10, 11, 11]


@pytest.mark.parametrize(
    ("every", "done", "left", "due"),
    [
        (Every(5), 0, 5, True),
        (Every(5), 3, 2, False),
        (Every(5), 5, 5, True),
        (Every(5, first=7), 0, 7, False),
        (Every(5, first=7), 5, 2, False),
        (Every(5, first=7), 7, 5, True),
        (Every(5, first=7), 12, 5, True),
        (Every(0), 0, NEVER, False),
    ],
)
def test_every_so_often_from_the_first_on(every: Every, done: int, left: int, due: bool) -> None:
    assert (every.left(done), every.due(done)) == (left, due)


def test_a_run_stops_where_something_is_due_and_nowhere_else() -> None:
    """35 ticks: samples after 10, 20, 30, histograms after 12 and 24, both at the end too, checkpoints after 20."""
    times = ("seconds=2.45", "record.every=0.7", "record.histograms=0.84", "checkpoint.every=1.4")
    plan = schedule(*times, "record.pictures=0")
    assert walk(plan) == [10, 12, 20, 24, 30, 35]
    found = {done: plan.due(done) for done in walk(plan)}
    assert [done for done, due in found.items() if due.sample] == [10, 20, 30, 35]
    assert [done for done, due in found.items() if due.histograms] == [12, 24, 35]
    assert [done for done, due in found.items() if due.checkpoint] == [20]
    assert not any(due.picture or due.point for due in found.values())
    assert not any(plan.filmed(done) for done in range(35))


def test_sampling_begins_where_it_is_told() -> None:
    plan = schedule("seconds=2.1", "record.every=0.7", "record.start=0.84", "record.pictures=0", "record.histograms=0")
    assert walk(plan) == [12, 22, 30]
    assert [plan.due(done).sample for done in (2, 12, 22, 29, 30)] == [False, True, True, False, True]


def test_loggers_get_less_of_a_run_of_few_trials() -> None:
    """20,000 ticks with 200 samples and 100 histograms, shown at most 61.4 and 4.14 times, or 760 and 74 times."""
    times = ("seconds=1400", "record.every=7", "record.histograms=14", "record.pictures=0")
    few, many = schedule(*times, "trials=1"), schedule(*times, "trials=500")
    assert walk(few)[:3] == [100, 200, 300]
    for plan, scalars, histograms in ((few, 400, 5000), (many, 100, 400)):
        found = {done: plan.due(done) for done in range(100, plan.end + 1, 100)}
        assert all(due.sample for due in found.values())
        assert [done for done, due in found.items() if due.scalars] == list(range(scalars, plan.end + 1, scalars))
        assert [done for done, due in found.items() if due.histograms] == list(
            range(histograms, plan.end + 1, histograms)
        )
    assert schedule("seconds=7.35", "record.every=0.07", "trials=1").due(105).scalars  # the end always is


def test_before_a_picture_there_is_a_film_with_a_point_every_so_often() -> None:
    """Pictures after 200 ticks and at the end, 260: each ends 28 points of 5 ticks, or what there is of them."""
    assert spacing(TICK) == (5, 28)
    plan = schedule("seconds=18.2", "record.every=70", "record.pictures=14", "record.histograms=0")
    assert walk(plan) == [60, *range(65, 261, 5)]
    assert [plan.filmed(done) for done in (0, 59, 60, 199, 200, 259)] == [False, False, True, True, True, True]
    points = [done for done in range(1, 261) if plan.due(done).point]
    assert points == list(range(65, 261, 5))
    assert [done for done in range(1, 261) if plan.due(done).picture] == [200, 260]
    assert walk(plan, pace=3)[-2:] == [258, 260]  # whatever the pace, nothing is missed
    assert set(walk(plan, pace=3)) > set(walk(plan))


def test_points_are_counted_back_from_the_picture() -> None:
    plan = schedule("seconds=0.49", "record.every=70", "record.pictures=70", "record.histograms=0")  # 7 ticks
    assert walk(plan) == [2, 7]
    assert [plan.due(done).point for done in range(1, 8)] == [False, True, False, False, False, False, True]


def test_a_run_shorter_than_the_intervals_has_histograms_and_a_picture_at_its_end() -> None:
    plan = schedule("seconds=7")
    assert plan.due(100).histograms
    assert plan.due(100).picture
    assert not plan.due(99).histograms
    never = schedule("seconds=7", "record.histograms=0", "record.pictures=0")
    assert not never.due(100).histograms
    assert not never.due(100).picture


def test_where_nothing_is_shown_there_are_no_histograms_and_pictures() -> None:
    plan = schedule("seconds=7", "record.every=3.5", "record.pictures=1", "record.histograms=1", shown=False)
    assert walk(plan) == [50, 100]
    assert not plan.due(100).picture
    assert not plan.due(100).histograms
    assert not plan.filmed(99)
