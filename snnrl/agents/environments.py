"""The robot's world as Gymnasium environments; importing this module registers one for each experiment with a world.

    import gymnasium
    import snnrl.environments

    gymnasium.register_envs(snnrl.environments)  # only so that the import is seen to be used
    environment = gymnasium.make("snnrl/FoodAttraction-v0", render_mode="rgb_array")
    environments = gymnasium.make_vec("snnrl/DualLearning-v0", num_envs=50, overrides=["world.side=200", "seconds=100"])

World, sensors, wheel speeds and the length of an episode are those of the experiment in conf/; `overrides` change
them as on the command line of `snnrl.run`. Observation, action, reward, info and rendering: docs/environments.md.

On the CPU the world is compiled; with `engine=reference` among the overrides it is plain torch, with the same results.

Seeding: an episode is the trial (seed, number), as everywhere in the package. Episode e of environment i
out of N has the number trial_start + e N + i; `reset(seed=...)` starts again with e = 0.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
import yaml
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from snnrl.agents.foraging import LEFT, RIGHT, Foraging
from snnrl.agents.window import Window
from snnrl.configuration.checks import check, torch_device
from snnrl.configuration.compose import compose, conf_dir
from snnrl.drawing.snapshots import square
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws
from snnrl.running.schedule import ticks_of

SEEDS = 2**63  # as many as `seed` of a run can have
PATH = 10_000  # ms of the robot's way that a picture shows
FINER = 2  # of pictures, see `snnrl.drawing.snapshots.square`
ELSEWHERE = {
    "seed": "is given to reset(seed=...)",
    "trials": "is num_envs",
    "experiment": "is an argument of its own",
}


class ForagingVectorEnv(VectorEnv):
    """N robots in N worlds, stepped together.

    All episodes are equally long, so all environments are reset together, by the step that follows the
    truncated one.

    Args:
        num_envs: N.
        experiment: of conf/.
        overrides: of the experiment's configuration.
        continuous: whether actions are wheel speeds.
        render_mode: rgb_array, or None.
        tensors: whether all that goes in and comes out are tensors on the configuration's `device`, and nothing
            is copied from there, instead of NumPy arrays.

    Raises:
        ConfigError: names a value that is out of bounds, contradicts another or is set elsewhere.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        experiment: str = "food_attraction",
        overrides: Sequence[str] = (),
        continuous: bool = False,
        render_mode: str | None = None,
        tensors: bool = False,
    ) -> None:
        if num_envs < 1:
            raise ConfigError("num_envs", num_envs, "must be at least 1")
        check_mode(render_mode, self.metadata)
        for override in overrides:
            key = override.partition("=")[0].lstrip("+")
            if key in ELSEWHERE:
                raise ConfigError("overrides", override, ELSEWHERE[key])
        self.config = compose(f"+experiment={experiment}", *overrides)
        check(self.config)
        self.device = torch_device(self.config.device)
        coding, _ = self.config.body()
        self.num_envs, self.continuous, self.render_mode, self.tensors = num_envs, continuous, render_mode, tensors
        self.metadata = {**self.metadata, "render_fps": 1000.0 / coding.tick, "torch": tensors}
        self.length = ticks_of(self.config.seconds, coding.tick)  # ticks
        self._path: deque[Tensor] = deque(maxlen=PATH // coding.tick)
        sensors = 2 * len(coding.ranges) + len(coding.touches)
        self.single_observation_space = spaces.Box(0.0, 1.0, (sensors,), np.float32)
        self.single_action_space = (
            spaces.Box(coding.slow, coding.fast, (2,), np.float32) if continuous else spaces.Discrete(RIGHT + 1)
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._bounds = (coding.slow, coding.fast) if continuous else (LEFT, RIGHT)
        self.episode = -1
        self.ticks = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode of all environments, or with a seed the first one.

        Without a seed ever given, one is drawn from the operating system. `options` has no meaning.
        """
        super().reset(seed=seed)
        self.episode = 0 if seed is not None else self.episode + 1
        first = self.config.trial_start + self.episode * self.num_envs
        trials = torch.arange(first, first + self.num_envs, device=self.device)
        self.foraging = Foraging(self.config, Draws(int(self.np_random_seed or 0) % SEEDS, trials))
        self.ticks, self.states = 0, self._states()
        self._path.clear()
        self._follow()
        return self._observe(), self._info()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One control tick; see `VectorEnv`.

        Raises:
            ValueError: if an action is outside the action space.
        """
        if self.ticks == self.length:
            observation, info = self.reset()
            return observation, self._full(0.0), self._full(False), self._full(False), info
        observation, reward = self.advance(actions)
        over = self._full(self.ticks == self.length)
        return observation, reward, self._full(False), over, self._info()

    def advance(self, actions: Any) -> tuple[Any, Any]:
        """One control tick of an episode that is not over: observation and reward."""
        reward = self.foraging.step(self._wheels(actions))
        self.ticks += 1
        self._follow()
        return self._observe(), reward if self.tensors else reward.cpu().numpy()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """The arena of each environment as it is now, uint8 [480, 480, 3]."""
        if self.render_mode is None:
            return None
        world, paths = self.foraging.world, torch.stack(list(self._path), 1).cpu().numpy()
        time = int(self.foraging.time)
        return tuple(square(world, path, time, trial, FINER) for trial, path in enumerate(paths))

    def _follow(self) -> None:
        if self.render_mode is not None:
            self._path.append(self.foraging.world.position.clone())

    def _observe(self) -> Any:
        senses = self.foraging.senses
        return senses.float() if self.tensors else senses.cpu().numpy().astype(np.float32)

    def _states(self) -> dict[str, Any]:
        """What info is made of: tensors of the world, or on the CPU arrays that share their memory."""
        world = self.foraging.world
        states = {name: getattr(world, name) for name in ("position", "heading", "touches")}
        states |= {"trial": world.draws.trials, "taken": self.foraging.taken}
        shared = self.device.type == "cpu" and not self.tensors
        return {key: value.numpy() if shared else value for key, value in states.items()}

    def _info(self) -> dict[str, Any]:
        """What there is to know now, [N, ...], copied; with a mask for each."""
        values = {key: self._copy(value) for key, value in self.states.items()}
        values["food"], values["poison"] = values.pop("taken").T
        masks, kinds = self._full(True), self.foraging.world.kinds.names
        values["touches"] = with_masks(dict(zip(kinds, values["touches"].T, strict=True)), masks)
        return with_masks(values, masks)

    def _copy(self, values: Any) -> Any:
        if isinstance(values, np.ndarray):
            return values.copy()
        return values.clone() if self.tensors else values.cpu().numpy()

    def _full(self, value: float) -> Any:
        """The same for all environments."""
        if not self.tensors:
            return np.full(self.num_envs, value)
        kind = torch.bool if isinstance(value, bool) else torch.float64
        return torch.full((self.num_envs,), value, dtype=kind, device=self.device)

    def _wheels(self, actions: Any) -> Tensor:
        kind = torch.float32 if self.continuous else torch.int64
        given = torch.as_tensor(actions, dtype=kind, device=self.device) if self.tensors else np.asarray(actions)
        least, most = self._bounds
        if given.shape != self.action_space.shape or not (least <= given.min() and given.max() <= most):
            raise ValueError(f"action={actions}: must be in {self.action_space}")
        wheels = torch.as_tensor(given, dtype=kind, device=self.device)
        return wheels.double() if self.continuous else self.foraging.wheels(wheels)


class ForagingEnv(gymnasium.Env):
    """One robot in its world: `ForagingVectorEnv` with N = 1, and its arguments.

    Args:
        render_mode: rgb_array, human (a window, for which there must be a display), or None.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"]}  # noqa: RUF012

    def __init__(
        self,
        experiment: str = "food_attraction",
        overrides: Sequence[str] = (),
        continuous: bool = False,
        render_mode: str | None = None,
    ) -> None:
        check_mode(render_mode, self.metadata)
        drawn = None if render_mode is None else "rgb_array"
        self.batch = ForagingVectorEnv(1, experiment, overrides, continuous, drawn)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self.batch.metadata["render_fps"]}
        self.window = Window(experiment, self.metadata["render_fps"]) if render_mode == "human" else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin the next episode, or with a seed the first one; see `ForagingVectorEnv.reset`."""
        super().reset(seed=seed)
        observation, _ = self.batch.reset(seed=seed, options=options)
        self._show()
        return observation[0], self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control tick; see `gymnasium.Env`."""
        batch = self.batch
        observation, reward = batch.advance(np.asarray(action)[None])
        self._show()
        return observation[0], reward.item(), False, batch.ticks >= batch.length, self._info()

    def render(self) -> np.ndarray | None:
        """The arena as it is now, uint8 [480, 480, 3]; None where it is in a window, or there is no mode."""
        pictures = self.batch.render()
        return pictures[0] if pictures is not None and self.window is None else None

    def close(self) -> None:
        if self.window is not None:
            self.window.close()

    def _info(self) -> dict[str, Any]:
        """As `ForagingVectorEnv` has it, of the one robot."""
        states = {key: value[0] for key, value in self.batch.states.items()}
        food, poison = states["taken"].tolist()
        kinds = self.batch.foraging.world.kinds.names
        return {
            "trial": int(states["trial"]),
            "position": np.array(states["position"]),
            "heading": float(states["heading"]),
            "food": food,
            "poison": poison,
            "touches": dict(zip(kinds, states["touches"].tolist(), strict=True)),
        }

    def _show(self) -> None:
        if self.window is not None and (pictures := self.batch.render()) is not None:
            self.window.show(pictures[0])


def with_masks(values: dict[str, Any], mask: Any) -> dict[str, Any]:
    """The values, each with the mask, as Gymnasium has it."""
    return {name: item for key, value in values.items() for name, item in ((key, value), (f"_{key}", mask))}


def check_mode(mode: str | None, metadata: dict[str, Any]) -> None:
    """Raise ConfigError if there is no such way to render."""
    modes = metadata["render_modes"]
    if mode is not None and mode not in modes:
        raise ConfigError("render_mode", mode, f"must be one of {', '.join(modes)}")


def experiments() -> list[str]:
    """Of conf/, those that have a world."""
    files = sorted(Path(conf_dir(), "experiment").glob("*.yaml"))
    described = {path.stem: yaml.safe_load(path.read_text()) for path in files}
    return [name for name, given in described.items() if {"override /world": None} not in given.get("defaults", [])]


for _experiment in experiments():
    gymnasium.register(
        f"snnrl/{_experiment.title().replace('_', '')}-v0",
        entry_point="snnrl.environments:ForagingEnv",
        vector_entry_point="snnrl.environments:ForagingVectorEnv",
        kwargs={"experiment": _experiment},
    )
