"""Experiments beyond the thesis: what they measure, by hand, and each at a small size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from labels import faults

from snnrl.beyond import avoidance, baseline, chain, changing_world, command
from snnrl.beyond.chain import learning_time
from snnrl.beyond.changing_world import REACHED, WINDOW, relearning, since_swap
from snnrl.beyond.course import Course, follow
from snnrl.beyond.page import BEGIN, END
from snnrl.configuration.compose import compose_baselines

CHANGING = ("+experiment=changing_world",)
OPTIONS = compose_baselines()
SMALL = ("trials=2", "seed=3000000", "threads=1")


def course(reward: list[float], every: float = 10.0) -> Course:
    """Of one trial and one kind, worth 1 each."""
    touches = np.array(reward)[:, None] * every
    worth = np.ones(len(reward))
    return Course("learning", every, {"food": touches, "poison": 0 * touches}, {"food": worth, "poison": worth})


def test_a_touch_is_worth_its_sign_at_the_time() -> None:
    found = Course(
        "learning",
        10.0,
        {"food": np.array([[3, 0], [4, 1]]), "poison": np.array([[1, 1], [0, 2]])},
        {"food": np.array([1.0, -1.0]), "poison": np.array([-1.0, 1.0])},
    )
    assert found.rate("food", "poison").tolist() == [[0.2, -0.1], [-0.4, 0.1]]
    assert found.time.tolist() == [10.0, 20.0]


def test_spans_begin_with_the_first_tick_after_a_swap() -> None:
    found = follow("random_walk", 0.5, OPTIONS, *CHANGING, "world.kinds.food.turns_every=1", "seconds=4", *SMALL)
    assert found.signs["food"].tolist() == [1, 1, -1, -1, 1, 1, -1, -1]
    assert (found.signs["poison"] == -found.signs["food"]).all()
    assert found.touches["food"].shape == (8, 2)


def test_the_same_world_for_agents_with_and_without_neurons() -> None:
    """All that was touched is counted, in spans of any length."""
    for agent in ("learning", "q_learning"):
        counts = [
            follow(agent, every, OPTIONS, *CHANGING, "world.kinds.food.turns_every=15", "seconds=30", *SMALL)
            for every in (3.0, 15.0)
        ]
        total = [sum(touches.sum() for touches in found.touches.values()) for found in counts]
        assert total[0] == total[1] > 0
        assert counts[0].rate("food", "poison").mean() == pytest.approx(counts[1].rate("food", "poison").mean())


def test_it_has_re_learnt_when_the_mean_over_the_window_is_reached() -> None:
    spans = 2 * WINDOW
    never, late = [0.9 * REACHED] * spans, [0.0] * WINDOW + [REACHED] * WINDOW
    one = [0.0] * 2 + [WINDOW * REACHED] + [0.0] * (spans - 3)
    found = relearning(course([*never, *late, *one]), 10.0 * spans)
    np.testing.assert_equal(found[:, 0], [np.nan, 10.0 * spans, 10.0 * WINDOW])


def test_rewards_are_cut_at_the_swaps() -> None:
    assert since_swap(course([1, 2, 3, 4, 5]), 20.0)[..., 0].tolist() == [[1, 2], [3, 4]]


def test_as_kinds_drift_reward_is_told_by_how_many_are_good() -> None:
    touches, two = np.ones((4, 2)), np.array([[1, 1], [1, 2], [1, 1], [1, 3]])
    found = Course(
        "learning",
        1.0,
        {"food": touches, "poison": two},
        {"food": np.array([1.0, -1.0, -1.0, 1.0]), "poison": np.array([-1.0, -1.0, 1.0, 1.0])},
    )
    row = changing_world.drift_table([found]).splitlines()[2].split(" | ")
    assert [cell.split(" [")[0] for cell in row] == ["| learning", "0.12", "3.00", "0.00", "-2.50"]


def test_a_page_gets_its_table_and_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(changing_world, "PERIODS", (60.0,))
    monkeypatch.setattr(changing_world, "SWAPS", 2)
    monkeypatch.setattr(changing_world, "LENGTH", 40.0)
    monkeypatch.setattr(changing_world, "AGENTS", ("learning", "sarsa_lambda"))
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.md"
    page.write_text(f"Before.\n{BEGIN}old\n{END}After.\n")
    command.main(["changing_world", "--part=0.5", "--page", "page.md", *SMALL])
    found = page.read_text()
    assert found.startswith("Before.\n<!--")
    assert found.endswith("-->\nAfter.\n")
    assert "old" not in found
    assert "(page.png)" in found
    assert found.count("| 60 s |") == 3
    assert found.count("\n| learning | ") == 1
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")
    assert "sarsa lambda" in capsys.readouterr().out


def test_what_moves_dopamine_is_weighed_over_the_synapses_that_are_there() -> None:
    world = ("+experiment=chain", "seconds=0.7", "+robot.weights.key_dopamine=3")
    found = follow("learning", 0.7, OPTIONS, *world, "robot.fixed=[key_dopamine]", *SMALL)
    assert found.weights["key_dopamine"].tolist() == pytest.approx([3.0, 3.0])
    assert follow("sarsa_lambda", 0.7, OPTIONS, "+experiment=chain", "seconds=0.7", *SMALL).weights == {}


def test_a_chain_is_learnt_at_half_of_what_a_wired_robot_collects() -> None:
    wired, slow = course([1.0] * 12), course([0.0] * 6 + [0.6] * 6)
    assert learning_time(slow, wired).tolist() == [110.0]  # 5 of 6 spans at 0.6
    assert np.isnan(learning_time(course([0.4] * 12), wired)).all()


def test_what_hurts_comes_to_be_touched_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(avoidance, "SECONDS", 600.0)
    found = {
        agent: follow(agent, 50.0, OPTIONS, "+experiment=avoidance", "seconds=600", *SMALL, "trials=6")
        for agent in ("learning", "no_pain")
    }
    poison = {agent: avoidance.late(ran, "poison").mean() for agent, ran in found.items()}
    assert poison["learning"] < 0.6 * poison["no_pain"]
    table = avoidance.make(["trials=1", "threads=1"], 0.17).table.splitlines()
    agents = ["learning", "thesis's network", "no pain", "sarsa lambda", "random walk"]
    assert [row.split(" | ")[0] for row in table[2:]] == [f"| {agent}" for agent in agents]
    assert table[-1].endswith("| 1.00 |")


def test_hunger_leaves_the_orbit_alike_as_negative_dopamine_and_as_pain() -> None:
    """Attraction listens to dopamine as much as, negatively, to pain; in the thesis's network avoidance helps it."""
    world = ("+experiment=avoidance", *SMALL, "trials=16", *baseline.ORBIT)
    left = {
        name: baseline.escaped(*world, f"robot={robot}", *more) for name, (robot, more) in baseline.VARIANTS.items()
    }
    assert left["dopamine alone, negative"].all()
    assert 0 < left["poison hurts, negative"].sum() < 16
    assert left["poison and hunger hurt, zero"].tolist() == left["poison hurts, negative"].tolist()
    for model in ("dopamine alone", "poison hurts"):
        for sign in ("zero", "positive"):
            assert left[f"{model}, {sign}"].sum() < left[f"{model}, negative"].sum()


def test_each_sign_of_the_baseline_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = baseline.Outcome(np.array([True, False]), np.array([1.0, 2.0]), np.array([0.1, 0.3]), np.array([0.5, 0.5]))
    monkeypatch.setattr(baseline, "_outcome", lambda robot, options, overrides, part: ours)
    page = baseline.make([])
    rows = [row.split(" | ") for row in page.table.splitlines()[2:]]
    assert [row[:2] for row in rows[::6]] == [["| dopamine alone", "negative"], ["| poison and hunger hurt", "zero"]]
    assert len(rows) == 7
    assert rows[0][2].startswith("50 % [")
    assert rows[0][4].startswith("0.200 [")
    assert not faults(page.figure)


def test_dopamine_moves_to_links_that_follow_soon() -> None:
    near, far = (chain.presented(gap, 20, ("trials=3", "threads=1")) for gap in (0.1, 3.0))
    assert near["key_touch"].mean() > chain.ANSWERS
    assert far["key_touch"].mean() < chain.ANSWERS


def test_every_chain_is_run_by_every_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chain, "SECONDS", 14.0)
    monkeypatch.setattr(chain, "EVERY", 1.4)
    monkeypatch.setattr(chain, "PRESENTED", 1)
    rows, gaps = (table.splitlines() for table in chain.make(SMALL, 1.0).table.split("\n\n"))
    assert len(gaps) == 2 + len(chain.GAPS)
    assert len(rows) == 2 + len(chain.CHAINS) * len(chain.AGENTS)
    assert sum(row.startswith("| key, container, food | learning |") for row in rows) == 1


@pytest.mark.parametrize(
    ("argument", "line"),
    [
        ("--page=page.md", "--page=page.md: must have the lines <!-- begin table --> and <!-- end table -->"),
        ("--page=none.md", "none.md"),
        ("--part=0", "--part=0.0: must be greater than 0 and at most 1"),
        ("trails=3", "trails"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(
    argument: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text("Nothing.\n")
    with pytest.raises(SystemExit):
        command.main(["changing_world", argument])
    error = capsys.readouterr().err
    assert error.startswith("snnrl.beyond: ")
    assert line in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["page.md"]
