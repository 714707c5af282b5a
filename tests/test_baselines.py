"""Agents against hand-computed tables, and the comparison from the command line."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import compose_config, make_simulation
from hydra import initialize_config_dir
from torch import Tensor

from snnrl.agents.agents import Braitenberg, QLearning, RandomWalk, Reinforce, SarsaLambda, epsilon_greedy, states_of
from snnrl.agents.baselines import Result, agent_robot, collect, markdown_of, marks_of, table_of, tasks_of
from snnrl.agents.foraging import LEFT, RIGHT, STRAIGHT
from snnrl.configuration.compose import conf_dir
from snnrl.engines import make_engine
from snnrl.model.draws import Draws
from snnrl.schema import (
    BaselinesConfig,
    BraitenbergConfig,
    Config,
    ConfigError,
    QLearningConfig,
    ReinforceConfig,
    SarsaLambdaConfig,
)

OPTIONS = BaselinesConfig(
    agents=["random_walk"],
    braitenberg=BraitenbergConfig(0.1),
    q_learning=QLearningConfig(4, 0.3, 0.95, 0.1),
    sarsa_lambda=SarsaLambdaConfig(4, 0.3, 0.95, 0.1, 0.8),
    reinforce=ReinforceConfig(4, 1.0, 0.95),
    samples=5,
)


def draws(trials: int = 1) -> Draws:
    return Draws(0, torch.arange(trials))


def see(*pairs: tuple[float, float]) -> Tensor:
    """One pair of range sensors, a trial each, [B, 1, 2]."""
    return torch.tensor(pairs, dtype=torch.float64)[:, None]


def whole(*values: int) -> Tensor:
    return torch.tensor(values)


def double(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize(
    ("pair", "state"),
    [((0, 0), 0), ((0.01, 0), 1), ((0.5, 0), 2), ((0.51, 0), 3), ((1, 0), 4), ((0, 0.25), 5), ((0, 1), 8)],
)
def test_states_of_one_pair_of_sensors(pair: tuple[float, float], state: int) -> None:
    assert states_of(see(pair), 4).tolist() == [state]


def test_states_of_two_pairs_are_all_different() -> None:
    values = [(0.0, 0.0), (0.3, 0.0), (0.8, 0.0), (0.0, 0.3), (0.0, 0.8)]
    ranges = torch.tensor([(a, b) for a in values for b in values], dtype=torch.float64)
    assert sorted(states_of(ranges, 2).tolist()) == list(range(25))


def test_q_learning_updates_as_computed_by_hand() -> None:
    """Q <- Q + 0.5 (r + 0.9 max Q' - Q), in each trial's own table."""
    agent = QLearning(draws(2), 1, QLearningConfig(bins=1, rate=0.5, discount=0.9, exploration=0.0))
    agent.values[0, 2] = double(1.0, 4.0, -3.0)
    agent.values[1, 0] = double(0.0, 2.0, 8.0)
    agent.learn(whole(0, 0), whole(LEFT, RIGHT), double(1.0, -1.0), whole(2, 1))
    expected = torch.zeros(2, 3, 3, dtype=torch.float64)
    expected[0, 2] = double(1.0, 4.0, -3.0)
    expected[0, 0, LEFT] = 0.5 * (1.0 + 0.9 * 4.0)  # 2.3
    expected[1, 0] = double(0.0, 2.0, 8.0 + 0.5 * (-1.0 - 8.0))  # 3.5
    torch.testing.assert_close(agent.values, expected, rtol=0, atol=1e-12)


def test_q_learning_learns_from_the_reward_of_its_last_choice() -> None:
    agent = QLearning(draws(), 1, QLearningConfig(bins=1, rate=0.5, discount=0.9, exploration=0.0))
    agent.values[0] = double(0.0, 1.0, 0.0)
    assert agent.act(see((1, 0)), double(0.0), torch.tensor(0)).item() == STRAIGHT
    assert float(agent.values[0, 1, STRAIGHT]) == 1.0  # nothing to learn from yet
    agent.act(see((0, 0)), double(2.0), torch.tensor(70))
    assert float(agent.values[0, 1, STRAIGHT]) == pytest.approx(1.0 + 0.5 * (2.0 + 0.9 * 1.0 - 1.0))


def test_sarsa_lambda_updates_and_traces_as_computed_by_hand() -> None:
    """delta = r + 0.5 Q' - Q; traces decay by 0.5 x 0.8 a step and are replaced; Q <- Q + 0.1 delta trace."""
    agent = SarsaLambda(draws(), 1, SarsaLambdaConfig(bins=1, rate=0.1, discount=0.5, exploration=0.0, trace=0.8))
    agent.values[0, 1, RIGHT] = 4.0
    agent.learn(whole(0), whole(LEFT), double(0.0), whole(1), whole(RIGHT))  # delta = 0.5 x 4 = 2
    assert float(agent.values[0, 0, LEFT]) == pytest.approx(0.2)
    agent.learn(whole(1), whole(RIGHT), double(1.0), whole(0), whole(LEFT))  # delta = 1 + 0.5 x 0.2 - 4 = -2.9
    assert float(agent.values[0, 1, RIGHT]) == pytest.approx(4.0 - 0.29)
    assert float(agent.values[0, 0, LEFT]) == pytest.approx(0.2 - 0.29 * 0.4)  # 0.084
    assert agent.traces[0, 0].tolist() == pytest.approx([0.4, 0.0, 0.0])
    agent.learn(whole(1), whole(RIGHT), double(0.0), whole(2), whole(STRAIGHT))  # delta = -3.71
    assert agent.traces[0, 1, RIGHT] == 1.0  # replaced, not 1.4
    assert float(agent.traces[0, 0, LEFT]) == pytest.approx(0.16)
    assert float(agent.values[0, 1, RIGHT]) == pytest.approx(3.71 - 0.371)
    assert float(agent.values[0, 0, LEFT]) == pytest.approx(0.084 - 0.371 * 0.16)
    assert int((agent.values != 0).sum()) == 2


def test_sarsa_learns_from_the_choice_it_makes_next() -> None:
    config = SarsaLambdaConfig(bins=1, rate=0.5, discount=0.9, exploration=1.0, trace=0.0)
    agent = SarsaLambda(draws(500), 1, config)
    agent.values[:, 0] = double(0.0, 3.0, 0.0)
    agent.act(see((1, 0)).expand(500, 1, 2), torch.zeros(500).double(), torch.tensor(0))
    first = agent.last
    assert first is not None
    chosen = agent.act(see((0, 0)).expand(500, 1, 2), torch.zeros(500).double(), torch.tensor(70))
    learnt = agent.values[agent.rows, first[0], first[1]]
    torch.testing.assert_close(learnt, torch.where(chosen == STRAIGHT, 0.5 * 0.9 * 3.0, 0.0).double())
    assert 100 < int((chosen == STRAIGHT).sum()) < 234  # a third, within 6 standard errors


def test_epsilon_greedy_takes_the_best_and_shares_ties_and_strays_evenly() -> None:
    trials = 6000
    values = double(1.0, 2.0, 2.0).expand(trials, 3)
    error = 0.5 * trials**-0.5

    def shares(epsilon: float) -> list[float]:
        choice = epsilon_greedy(values, epsilon, draws(trials), torch.tensor(140))
        return [float((choice == k).double().mean()) for k in range(3)]

    assert shares(0.0) == [0.0, pytest.approx(0.5, abs=4 * error), pytest.approx(0.5, abs=4 * error)]
    assert shares(0.3) == pytest.approx([0.1, 0.45, 0.45], abs=4 * error)


def test_reinforce_credits_choices_by_the_gradient_of_the_log_of_their_chances() -> None:
    """Of a softmax: 1 - p for what was chosen, -p for the others; half of it is left a tick later."""
    agent = Reinforce(draws(), 1, ReinforceConfig(bins=1, rate=2.0, discount=0.5))
    agent.preferences[0, 1] = double(math.log(2.0), 0.0, 0.0)
    chances = agent.preferences[0, 1].softmax(0)[None]
    agent.credit(whole(1), whole(STRAIGHT), chances)
    assert agent.traces[0, 1].tolist() == pytest.approx([-0.5, 0.75, -0.25])
    agent.act(see((0, 0)), double(1.0), torch.tensor(0))
    assert agent.preferences[0, 1].tolist() == pytest.approx([math.log(2.0) - 1.0, 1.5, -0.5])
    assert agent.traces[0, 1].tolist() == pytest.approx([-0.25, 0.375, -0.125])


def test_reinforce_in_many_worlds_is_one_agent() -> None:
    agent = Reinforce(draws(3), 1, ReinforceConfig(4, 0.5, 0.95, shared=True))
    agent.traces[0, 2, 1], agent.traces[1, 2, 1], agent.traces[2, 3, 0] = 1.0, 2.0, 4.0
    agent.act(see((0, 0)).expand(3, 1, 2), double(1.0, -1.0, 1.0), torch.tensor(0))
    assert agent.preferences[:, 2, 1].tolist() == [-0.5] * 3
    assert agent.preferences[:, 3, 0].tolist() == [2.0] * 3


def test_reinforce_chooses_by_its_chances() -> None:
    agent = Reinforce(draws(4000), 1, ReinforceConfig(bins=1, rate=1.0, discount=0.9))
    agent.preferences[:, 0] = double(math.log(1.0), math.log(2.0), math.log(5.0))
    choice = agent.act(see((0, 0)).expand(4000, 1, 2), torch.zeros(4000).double(), torch.tensor(0))
    shares = torch.bincount(choice, minlength=3) / 4000
    assert shares.tolist() == pytest.approx([1 / 8, 2 / 8, 5 / 8], abs=0.03)


def test_the_braitenberg_vehicle_turns_towards_what_it_senses() -> None:
    agent = Braitenberg(draws(4), BraitenbergConfig(0.0))
    ranges = torch.zeros(4, 2, 2, dtype=torch.float64)
    ranges[0, 0, 0], ranges[1, 0, 1], ranges[2, 1, 1] = 0.3, 0.3, 0.9
    choice = agent.act(ranges, torch.zeros(4), torch.tensor(0))
    assert choice.tolist() == [LEFT, RIGHT, RIGHT, STRAIGHT]


@pytest.mark.parametrize("name", ["braitenberg", "q_learning", "sarsa_lambda", "reinforce"])
def test_a_trial_does_not_depend_on_its_batch(name: str) -> None:
    def touches(trials: int, start: int) -> Tensor:
        config = compose_config("+experiment=food_attraction", f"trials={trials}", f"trial_start={start}")
        world, advance = agent_robot(config, name, OPTIONS)
        advance(400)
        return torch.cat([world.touches.double(), world.position], 1)

    assert torch.equal(touches(3, 4)[1], touches(1, 5)[0])


def test_learners_come_to_collect_more_than_a_random_walk() -> None:
    config = compose_config("+experiment=food_attraction", "trials=20", "seconds=84", "seed=11")
    late = {}
    for name in ("random_walk", "q_learning", "sarsa_lambda", "reinforce"):
        late[name] = collect("food", name, config, OPTIONS).items[-1].mean()
    assert late["q_learning"] > 1.5 * late["random_walk"]
    assert late["sarsa_lambda"] > 1.5 * late["random_walk"]
    assert late["reinforce"] > 1.5 * late["random_walk"]


def test_a_random_walk_collects_what_the_spiking_random_walk_does() -> None:
    trials, ticks = 100, 800
    simulation = make_simulation("+experiment=food_attraction", "robot=random_walk", f"trials={trials}", "seed=5")
    simulation.run(make_engine("fused", "cpu"), ticks)
    config = compose_config("+experiment=food_attraction", f"trials={trials}", "seed=6")
    world, advance = agent_robot(config, "random_walk", OPTIONS)
    advance(ticks)
    counts = [w.touches[:, 0].double() for w in (simulation.situation.world, world)]
    error = math.sqrt(sum(float(c.var()) for c in counts) / trials)
    assert 10 < float(counts[0].mean()) < 20
    assert abs(float(counts[0].mean() - counts[1].mean())) < 3 * error


def test_a_random_walk_turns_to_either_side() -> None:
    choice = RandomWalk(draws(2000)).act(torch.zeros(2000, 1, 2), torch.zeros(2000), torch.tensor(0))
    assert set(choice.tolist()) == {LEFT, RIGHT}
    assert float((choice == LEFT).double().mean()) == pytest.approx(0.5, abs=0.045)


def config_of(*overrides: str) -> Config:
    return compose_config("+experiment=food_attraction", "seconds=7", *overrides)


def test_counting_covers_the_task_and_meets_the_turn_to_poison() -> None:
    assert marks_of(config_of(), 4) == [25, 50, 75, 100]
    assert marks_of(config_of("world.kinds.food.poison_from=3.6"), 4) == [25, 52, 75, 100]  # tick 52 is at 3.64 s
    assert marks_of(config_of("world.kinds.food.poison_from=9"), 1) == [100]
    assert marks_of(config_of(), 1000) == list(range(1, 101))


def test_a_task_whose_food_turns_again_and_again_is_refused() -> None:
    with initialize_config_dir(conf_dir(), version_base="1.3"):
        options = replace(OPTIONS, tasks={"odd": ["+experiment=changing_world"]})
        with pytest.raises(ConfigError, match=r"^tasks\.odd=\.\.\.: world\.kinds\.food\.turns_every must be null"):
            tasks_of(options)


def test_a_task_is_longer_than_its_food_is_food() -> None:
    def refusal(seconds: float) -> str:
        task = ["+experiment=food_poison", "world.kinds.food.poison_from=2.1"]  # 30 ticks
        options = replace(OPTIONS, tasks={"poison": task}, seconds=seconds)
        with initialize_config_dir(conf_dir(), version_base="1.3"):
            try:
                (config,) = tasks_of(options).values()
            except ConfigError as error:
                return str(error)
        assert collect("poison", "random_walk", config, options).poison.any()
        return ""

    for seconds in (1.0, 2.1, 2.13):  # whole ticks are run
        assert refusal(seconds).startswith(f"seconds={seconds}: must be greater than the 2.1 s after which food turns")
    assert refusal(2.17) == ""


def test_items_are_counted_as_food_or_poison_by_when_they_were_taken() -> None:
    config = config_of("world.kinds.food.poison_from=3.6", "trials=30")
    result = collect("food", "braitenberg", config, OPTIONS)
    assert result.poison.tolist() == [False, False, False, True, True]
    world, advance = agent_robot(config, "braitenberg", OPTIONS)
    advance(52)
    food = world.touches[:, 0].clone()
    advance(48)
    poison = world.touches[:, 0] - food
    row = result.row()
    assert row["food_mean"] == pytest.approx(float(food.double().mean()))
    assert row["poison_mean"] == pytest.approx(float(poison.double().mean()))
    assert float(poison.sum()) > 0


def test_a_row_of_the_table_by_hand() -> None:
    """Two trials that collect 2, 0 and then 4, 2 as food, and then 1, 1 as poison."""
    items = np.array([[2, 0], [4, 2], [1, 1]])
    result = Result("t", "spiking", np.array([2.0, 4.0, 5.0]), items, np.array([False, False, True]))
    row = result.row()
    assert (row["food_mean"], row["poison_mean"], row["reward_mean"]) == (4.0, 1.0, 3.0)
    assert row["food_sd"] == pytest.approx(math.sqrt(8))
    assert row["reward_high"] == pytest.approx(3.0 + 12.706205 * 2.0)  # Student's t with one degree of freedom
    assert row["late_rate"] == pytest.approx(1.0)
    assert "| t | spiking | 2 x 5 | 4.0 (2.8) | 1.0 (0.0) | 3.0 [-22.4, 28.4] | 1.000 |" in markdown_of([result])
    assert table_of([result]).splitlines()[1].startswith("t,spiking,2,5,4,2.82843,1,0,3,-22.4124,28.4124,1")


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "snnrl.run", "+experiment=baselines", *arguments],
        cwd=folder,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_the_command_leaves_a_table_and_a_plot(tmp_path: Path) -> None:
    poison = 'tasks.food_poison=["+experiment=food_poison","world.kinds.food.poison_from=2"]'
    done = command(tmp_path, "trials=2", "seconds=3.5", "seed=3", poison, "hydra.run.dir=here")
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    rows = list(csv.DictReader((tmp_path / "here" / "baselines.csv").open()))
    agents = ["spiking", "random_walk", "braitenberg", "q_learning", "sarsa_lambda"]
    tasks = ["food_attraction", "food_poison", "food_containers"]
    assert [(row["task"], row["agent"]) for row in rows] == [(task, agent) for task in tasks for agent in agents]
    assert (tmp_path / "here" / "baselines.md").read_text() in done.stdout
    assert (tmp_path / "here" / "baselines.png").read_bytes().startswith(b"\x89PNG")
    series = np.load(tmp_path / "here" / "series.npz")
    for row in rows:
        items = series[f"{row['task']}.{row['agent']}.items"]
        assert items.sum() == 2 * (float(row["food_mean"]) + float(row["poison_mean"]))


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("agents=[odd]", "agents=odd: must be one of spiking, random_walk"),
        (
            "sarsa_lambda.odd=2",
            "sarsa_lambda.odd=2: no such key; allowed here: bins, rate, discount",
        ),
        (
            "seconds=1000",
            "seconds=1000.0: must be greater than the 1000 s after which food turns to poison in food_poison (leave "
            "that task out with ~tasks.food_poison)",
        ),
        ("tasks.own=3", "tasks.own=3: must be a list [...]"),
        ("robot=learning", "robot=learning: no such key; allowed here: tasks, agents, braitenberg"),
        ("+tasks.own=[+experiment\\=odd]", "experiment=odd: must be one of "),
    ],
)
def test_bad_input_gets_one_line_and_leaves_no_folder(tmp_path: Path, argument: str, message: str) -> None:
    done = command(tmp_path, argument)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []
