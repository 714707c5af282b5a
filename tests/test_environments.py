"""Gymnasium's view of the world is the spiking robot's world, reproducible and within Gymnasium's contract."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv
from helpers import make_simulation, place
from labels import faults
from PIL import ImageColor

import snnrl.environments
from snnrl.agents.environments import experiments
from snnrl.agents.foraging import LEFT, RIGHT, STRAIGHT, Foraging
from snnrl.beyond.page import BEGIN, END
from snnrl.body.world import World
from snnrl.configuration.builder import build_world
from snnrl.configuration.compose import compose
from snnrl.drawing.palette import FOOD, POISON
from snnrl.engines import compiled_world, make_engine
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws

NAMES = {"snnrl/FoodAttraction-v0": 3, "snnrl/DualLearning-v0": 7}  # numbers of sensors


IDS = sorted(name for name in gymnasium.registry if name.startswith("snnrl/"))
PAGE = Path(__file__).parents[1] / "docs" / "environments.md"


def make(name: str = "snnrl/FoodAttraction-v0", num_envs: int = 3, **options: Any) -> Any:
    return gymnasium.make_vec(name, num_envs=num_envs, **options)


def play(environments: VectorEnv, steps: int) -> list[tuple[np.ndarray, ...]]:
    """Observation, reward, termination and truncation of steps with actions that depend on the step alone."""
    width = environments.num_envs
    return [environments.step((np.arange(width) + k) // 5 % 3)[:4] for k in range(steps)]


def equal(one: list[tuple[np.ndarray, ...]], other: list[tuple[np.ndarray, ...]]) -> bool:
    return all(np.array_equal(a, b) for x, y in zip(one, other, strict=True) for a, b in zip(x, y, strict=True))


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("continuous", [False, True])
def test_a_single_environment_keeps_gymnasiums_contract(name: str, continuous: bool) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")  # wheel speeds are in cm/s
        check_env(gymnasium.make(name, continuous=continuous).unwrapped, skip_render_check=True)


def test_there_is_an_environment_for_each_experiment_with_a_world() -> None:
    files = (Path(__file__).parents[1] / "conf" / "experiment").glob("*.yaml")
    with_world = [path.stem for path in sorted(files) if compose(f"+experiment={path.stem}").world is not None]
    assert experiments() == with_world
    assert [gymnasium.spec(name).kwargs["experiment"] for name in IDS] == with_world
    assert {"snnrl/FoodAttraction-v0", "snnrl/DualLearning-v0"} <= set(IDS)
    assert all(f"`{name}`" in PAGE.read_text() for name in IDS)


@pytest.mark.parametrize("engine", ["fused", "reference"])
def test_info_tells_what_has_happened_and_where_the_robot_is(engine: str) -> None:
    options = [f"engine={engine}", "world.kinds.food.poison_from=0.14"]  # the third tick begins then
    environments = make(num_envs=2, overrides=options)
    _, before = environments.reset(seed=0)
    world = environments.unwrapped.foraging.world
    place(world, (50.0, 50.0), heading=0.0, items=[(50.0, 50.0)] * 2 + [(10.0, 90.0)] * 18, trial=1)
    *_, info = environments.step(np.ones(2, dtype=int))
    assert (before["food"][1], info["food"][1], info["poison"][1]) == (0, 2, 0)
    assert info["touches"]["food"][1] == 2
    assert info["position"][1].tolist() == pytest.approx([50.0 + 28.1 * 0.07, 50.0])
    assert info["heading"][1] == 0.0
    assert info["_food"].all()
    assert info["touches"]["_food"].all()
    environments.step(np.ones(2, dtype=int))
    place(world, (50.0, 50.0), heading=0.0, items=[(50.0, 50.0)] + [(10.0, 90.0)] * 19, trial=1)
    _, reward, *_, later = environments.step(np.ones(2, dtype=int))
    assert (later["food"][1], later["poison"][1], reward[1]) == (2, 1, -1.0)
    assert info["food"][1] == 2  # as it was


def test_tensors_are_the_arrays_and_never_leave_their_device(monkeypatch: pytest.MonkeyPatch) -> None:
    arrays, tensors = (make(overrides=["engine=reference"], tensors=tensors) for tensors in (False, True))
    first, _ = arrays.reset(seed=3)
    assert np.array_equal(first, tensors.reset(seed=3)[0].numpy())

    def forbidden(self: torch.Tensor, *arguments: Any) -> None:
        raise AssertionError("copied from the device")

    for k in range(40):
        *expected, info = arrays.step(np.full(3, k // 9 % 3))
        with monkeypatch.context() as patch:
            for name in ("cpu", "numpy", "tolist", "__array__"):
                patch.setattr(torch.Tensor, name, forbidden)
            *found, shown = tensors.step(torch.full((3,), k // 9 % 3))
        for one, other in zip(expected, found, strict=True):
            assert np.array_equal(one, other.numpy())
        assert np.array_equal(info["position"], shown["position"].numpy())
        assert np.array_equal(info["touches"]["food"], shown["touches"]["food"].numpy())
    assert isinstance(shown["food"], torch.Tensor)


def test_pictures_show_what_is_where_in_the_house_colours() -> None:
    environments = make(num_envs=2, render_mode="rgb_array", overrides=["world.kinds.food.poison_from=0.07"])
    environments.reset(seed=0)
    world = environments.unwrapped.foraging.world
    place(world, (50.0, 10.0), items=[(100.0, 50.0)] * 20)
    first, second = environments.render()
    assert first.shape == second.shape == (480, 480, 3)
    assert first.dtype == np.uint8
    assert not np.array_equal(first, second)
    for column in (5, 474):  # on both edges of the torus
        assert tuple(first[240, column]) == ImageColor.getrgb(FOOD)
    assert tuple(first[240, 240]) == (255, 255, 255)
    environments.step(np.ones(2, dtype=int))
    assert tuple(environments.render()[0][240, 5]) == ImageColor.getrgb(POISON)
    assert make(num_envs=1).render() is None


def test_a_video_is_recorded(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason='needs pip install "snnrl[video]"')
    environment = gymnasium.make("snnrl/DualLearning-v0", overrides=["seconds=1.4"], render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # moviepy's own
        recorded = gymnasium.wrappers.RecordVideo(environment, str(tmp_path))
        recorded.reset(seed=0)
        while not recorded.step(STRAIGHT)[3]:
            pass
        recorded.close()
    (film,) = tmp_path.glob("*.mp4")
    assert film.stat().st_size > 3000


WINDOW = """
import gymnasium, snnrl.environments
from gymnasium.utils.env_checker import check_env
from snnrl.errors import ConfigError
try:
    environment = gymnasium.make("snnrl/FoodAttraction-v0", render_mode="human")
except ConfigError as error:
    print(error)
else:
    environment.reset(seed=0)
    environment.step(0)
    assert environment.render() is None
    check_env(environment.unwrapped)
    environment.close()
    print("shown")
"""


@pytest.mark.parametrize(("driver", "line"), [("dummy", "shown"), ("nothing", "render_mode=human: needs a display")])
def test_a_window_needs_a_display(driver: str, line: str) -> None:
    """In a process of its own: SDL and other libraries do not always agree within one."""
    pytest.importorskip("pygame", reason='needs pip install "snnrl[render]"')
    environment = {**os.environ, "SDL_VIDEODRIVER": driver}
    shown = subprocess.run([sys.executable, "-c", WINDOW], env=environment, capture_output=True, text=True, check=False)
    assert shown.stdout.splitlines()[-1].startswith(line), shown.stderr


def test_a_window_without_pygame_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ConfigError, match=r'needs pygame: pip install "snnrl\[render\]"'):
        gymnasium.make("snnrl/FoodAttraction-v0", render_mode="human")


@pytest.mark.parametrize("name", NAMES)
def test_spaces_and_declared_autoreset(name: str) -> None:
    environments = make(name, 4)
    assert environments.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert environments.single_observation_space.shape == (NAMES[name],)
    assert environments.single_action_space == gymnasium.spaces.Discrete(3)
    observation, info = environments.reset(seed=1)
    assert observation in environments.observation_space
    assert info["trial"].tolist() == [0, 1, 2, 3]
    assert environments.step(environments.action_space.sample())[0] in environments.observation_space
    speeds = make(name, continuous=True).single_action_space
    assert speeds.low.tolist() == [25.0, 25.0]
    assert speeds.high.tolist() == pytest.approx([31.2, 31.2])


def test_the_module_can_be_named_with_the_environment() -> None:
    assert gymnasium.make("snnrl.environments:snnrl/FoodAttraction-v0").observation_space.shape == (3,)


def test_the_same_seed_gives_the_same_episodes_and_another_gives_others() -> None:
    environments, again = make(overrides=["seconds=1.4"]), make(overrides=["seconds=1.4"])
    first, other = environments.reset(seed=7)[0], again.reset(seed=7)[0]
    assert np.array_equal(first, other)
    run = play(environments, 50)  # 20 steps an episode
    assert equal(run, play(again, 50))
    assert np.array_equal(environments.reset(seed=7)[0], first)
    assert equal(run, play(environments, 50))
    assert not np.array_equal(environments.reset(seed=8)[0], first)
    assert not np.array_equal(make().reset()[0], make().reset()[0])  # unseeded


def test_an_episode_is_the_trial_of_its_number_whoever_plays_it() -> None:
    together = make("snnrl/DualLearning-v0", 3)
    together.reset(seed=5)
    alone = gymnasium.make("snnrl/DualLearning-v0", overrides=["trial_start=1"]).unwrapped
    _, info = alone.reset(seed=5)
    assert info["trial"] == 1
    for k in range(300):
        observations, rewards, *_ = together.step(np.full(3, k // 20 % 3))
        observation, reward, *_ = alone.step(k // 20 % 3)
        assert np.array_equal(observations[1], observation)
        assert rewards[1] == reward
    assert alone.reset()[1]["trial"] == 2


def test_all_environments_are_truncated_together_and_reset_by_the_next_step() -> None:
    environments = make(num_envs=2, overrides=["seconds=0.35"])
    start, _ = environments.reset(seed=0)
    for k in range(5):
        last, _, terminated, truncated, _ = environments.step(np.ones(2, dtype=int))
        assert truncated.tolist() == [k == 4] * 2
        assert not terminated.any()
    observation, reward, terminated, truncated, info = environments.step(np.ones(2, dtype=int))
    assert info["trial"].tolist() == [2, 3]
    assert not terminated.any()
    assert not truncated.any()
    assert reward.tolist() == [0, 0]
    fresh = make(num_envs=2, overrides=["trial_start=2"])
    assert np.array_equal(observation, fresh.reset(seed=0)[0])  # the action was not played
    assert not np.array_equal(observation, start)
    assert not np.array_equal(observation, last)
    assert environments.reset(seed=0)[1]["trial"].tolist() == [0, 1]


def test_a_single_environment_goes_on_to_the_next_trial() -> None:
    environment = gymnasium.make("snnrl/FoodAttraction-v0", overrides=["seconds=0.14"])
    assert environment.reset(seed=0)[1]["trial"] == 0
    assert not environment.step(STRAIGHT)[3]
    assert environment.step(STRAIGHT)[3]
    assert environment.reset()[1]["trial"] == 1


@pytest.mark.parametrize("continuous", [False, True])
@pytest.mark.parametrize(
    ("experiment", "trials", "overrides"),
    [
        ("food_attraction", 7, []),
        ("food_attraction", 6, ["world.ranges.food.answers=both"]),
        ("food_poison", 5, ["world.kinds.food.poison_from=50"]),
        ("dual_learning", 13, ["world.ranges.food.measured_to=border"]),
    ],
)
def test_the_compiled_world_is_the_torch_world(
    experiment: str, trials: int, overrides: list[str], continuous: bool
) -> None:
    def environments(engine: str) -> Any:
        options = [*overrides, f"engine={engine}", "trial_start=3"]
        made = snnrl.environments.ForagingVectorEnv(trials, experiment, options, continuous)
        return made, made.reset(seed=11)[0]

    (compiled, first), (torch_world, other) = environments("auto"), environments("reference")
    assert compiled.foraging._compiled is not None
    assert torch_world.foraging._compiled is None
    assert np.array_equal(first, other)
    compiled.action_space.seed(5)
    earned = np.zeros(trials)
    for k in range(1500):
        if k % 9 == 0:
            action = compiled.action_space.sample()
        (seen, reward, *_), (expected, wanted, *_) = compiled.step(action), torch_world.step(action)
        assert np.array_equal(seen, expected)
        assert np.array_equal(reward, wanted)
        assert torch.equal(compiled.foraging.ranges(), torch_world.foraging.ranges())
        earned += np.abs(reward)
        for name, values in torch_world.foraging.world.state_dict().items():
            assert torch.equal(compiled.foraging.world.state_dict()[name], values), (k, name)
    assert earned.sum() >= 10


def test_a_world_with_code_of_its_own_is_refused_by_name() -> None:
    class Mine(World):
        pass

    coding, world = compose("+experiment=food_attraction").body()
    mine = build_world(world, coding, Draws(0, torch.arange(2)), Mine)
    assert compiled_world("reference", mine, ["food"], []) is None
    with pytest.raises(ConfigError, match="cannot run Mine; use engine=reference"):
        compiled_world("auto", mine, ["food"], [])


def test_wheel_speeds_of_one_robot_are_those_of_all() -> None:
    bodies = [
        Foraging(compose("+experiment=food_attraction", f"engine={engine}"), Draws(0, torch.arange(3)))
        for engine in ("fused", "reference")
    ]
    for body in bodies:
        body.step(torch.tensor([[26.0, 30.0]]))
    assert torch.equal(*(body.world.position for body in bodies))
    assert torch.equal(*(body.world.heading for body in bodies))


@pytest.mark.parametrize(
    ("experiment", "robot", "overrides"),
    [
        ("food_attraction", "learning", ["world.kinds.food.poison_from=21", "world.kinds.food.turns_every=7"]),
        ("dual_learning", "benchmark", []),
    ],
)
def test_driven_like_the_spiking_robot_it_is_the_same_world(experiment: str, robot: str, overrides: list[str]) -> None:
    trials, ticks = 3, 600
    simulation = make_simulation(
        f"+experiment={experiment}", f"robot={robot}", f"trials={trials}", "seed=3", *overrides
    )
    engine = make_engine("fused", "cpu", 1)
    environments = snnrl.environments.ForagingVectorEnv(trials, experiment, overrides)
    environments.reset(seed=3)
    motors = simulation.situation.coding.motor_groups
    total, least = np.zeros(trials), 0.0
    for _ in range(ticks):
        unread = simulation.network.spike_count[:, motors] - simulation.situation.coding.decoded
        lead = torch.sign(unread[:, 0] - unread[:, 1])
        simulation.run(engine, 1)
        observation, reward, *_ = environments.step((STRAIGHT + lead).numpy())
        assert torch.equal(environments.foraging.world.touches, simulation.situation.world.touches)
        seen = np.concatenate(
            [simulation.situation.world.sense()[name].numpy() for name in simulation.situation.coding.config.ranges], 1
        )
        np.testing.assert_allclose(observation[:, : seen.shape[1]], seen, atol=1e-6)
        total, least = total + reward, min(least, reward.min())
    touches = simulation.situation.world.touches
    assert int(touches[:, 0].min()) > 0
    if overrides:
        assert least == -1
        assert np.all(np.abs(total) < touches[:, 0].numpy())
    else:
        assert total.tolist() == touches[:, 0].tolist()
        assert int(touches[:, simulation.situation.world.kinds.names.index("food_container")].min()) > 0


def test_choices_turn_the_robot_to_the_side_of_their_name() -> None:
    environments = make(num_envs=3)
    environments.reset(seed=0)
    world = environments.unwrapped.foraging.world
    for trial in range(3):
        place(world, (50.0, 50.0), heading=1.0, items=[(0.0, 0.0)] * 20, trial=trial)
    environments.step(np.array([LEFT, STRAIGHT, RIGHT]))
    assert world.heading.tolist() == pytest.approx([1.0 + 6.2 * 0.07, 1.0, 1.0 - 6.2 * 0.07], abs=1e-12)


def test_wheel_speeds_drive_the_robot() -> None:
    environments = make(num_envs=2, continuous=True)
    environments.reset(seed=0)
    before = environments.unwrapped.foraging.world.heading.clone()
    environments.step(np.array([[26.0, 30.0], [28.0, 28.0]], dtype=np.float32))
    turned = environments.unwrapped.foraging.world.heading - before
    assert turned.remainder(2 * torch.pi).tolist() == pytest.approx([4.0 * 0.07, 0.0], abs=1e-9)


def test_touches_are_observed_when_they_happen_and_food_is_worth_one() -> None:
    environments = make("snnrl/DualLearning-v0", 1, overrides=["world.kinds.food_container.count=1"])
    environments.reset(seed=0)
    world = environments.unwrapped.foraging.world
    place(world, (85.0, 100.0), items=[(100.0, 100.0)], containers=[(100.0, 100.0)])
    seen = [environments.step(np.array([STRAIGHT])) for _ in range(16)]
    felt, reward = np.stack([s[0][0, 4:] for s in seen]), [float(s[1][0]) for s in seen]
    food, food_container, empty_container = felt.T
    assert food_container.tolist() == [1.0] + [0.0] * 15
    assert empty_container.sum() == 0
    assert food.sum() == 1
    assert reward == food.tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"overrides": ["seed=3"]}, "overrides=seed=3: is given to reset"),
        ({"overrides": ["trials=3"]}, "overrides=trials=3: is num_envs"),
        ({"overrides": ["world.side=10"]}, "world.side=10.0: must be at least"),
        ({"render_mode": "human"}, "render_mode=human: must be one of rgb_array"),
        ({"num_envs": 0}, "num_envs=0: must be at least 1"),
    ],
)
def test_bad_options_are_refused_by_name(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace("(", r"\(")):
        make(**options)


def test_an_action_outside_its_space_is_refused() -> None:
    environments = make(num_envs=2)
    environments.reset(seed=0)
    for action in ([0, 3], [-1, 0], [0], [[0, 1]]):
        with pytest.raises(ValueError, match="must be in MultiDiscrete"):
            environments.step(np.array(action))
    speeds = make(num_envs=1, continuous=True)
    speeds.reset(seed=0)
    for speed in (24.9, 31.3, np.nan):
        with pytest.raises(ValueError, match="must be in Box"):
            speeds.step(np.array([[28.0, speed]]))
    alone = gymnasium.make("snnrl/FoodAttraction-v0")
    alone.reset(seed=0)
    with pytest.raises(ValueError, match="must be in MultiDiscrete"):
        alone.step(3)


def test_the_example_trains_ppo() -> None:
    pytest.importorskip("stable_baselines3", reason='needs pip install "snnrl[rl]"')
    example = Path(__file__).parents[1] / "examples" / "ppo.py"
    options = ["--steps", "1", "--trials", "2", "--seconds", "3.5"]
    done = subprocess.run(
        [sys.executable, str(example), *options], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "reward" in done.stdout


def test_the_example_measures_learning_per_step(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason='needs pip install "snnrl[rl]"')
    example = Path(__file__).parents[1] / "examples" / "learning_curves.py"
    page = tmp_path / "page.md"
    page.write_text(BEGIN + END)
    options = [
        "--trials",
        "2",
        "--lives",
        "2",
        "--seeds",
        "2",
        "--worlds",
        "4",
        "--steps",
        "400",
        "seconds=7",
        "--page",
        str(page),
    ]
    done = subprocess.run(
        [sys.executable, str(example), *options], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    rows = [line.split(" | ") for line in page.read_text().splitlines() if line.startswith("| food")]
    assert [row[2] for row in rows] == ["2"] * 12
    assert {row[3] for row in rows} == {"100", "400"}
    assert page.with_suffix(".png").exists()


def test_a_curve_has_reached_a_rate_that_lasts_a_tenth_of_it() -> None:
    curves = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "learning_curves.py"))
    rate = np.zeros((20, 3))
    rate[5:, 0], rate[7, 1], rate[8:10, 2] = 1.0, 1.0, 1.0
    curve = curves["Curve"]("spiking", 50.0, rate)
    np.testing.assert_equal(curve.reached(1.0), [350.0, np.nan, 500.0])
    assert not faults(curves["figure_of"]({"food": ([curve], 1.0)}))
