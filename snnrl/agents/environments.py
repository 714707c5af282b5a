"""The robot's world as Gymnasium environments; importing this module registers them.

    import gymnasium
    import snnrl.environments

    gymnasium.register_envs(snnrl.environments)  # only so that the import is seen to be used
    environments = gymnasium.make_vec("snnrl/Foraging-v0", num_envs=50)
    environment = gymnasium.make("snnrl/FoodContainers-v0", overrides=["world.side=200", "seconds=100"])

World, sensors, wheel speeds and the length of an episode are those of an experiment in conf/;
`overrides` change them as on the command line of `snnrl.run`.

Observation: the range sensors (left and right of each) and the touch sensors, in the order of
`coding.ranges` and `coding.touches`; float32 in [0, 1]. Action: 0, 1, 2 for a turn to the left, straight
ahead, a turn to the right, at the spiking robot's speeds; with `continuous=True` the speeds of the left and
the right wheel, cm/s, between `coding.slow` and `coding.fast`. Reward: +1 for food, -1 for poison.
An episode is truncated after the experiment's `seconds`; nothing terminates it.

On the CPU the world is compiled; with `engine=reference` among the overrides it is plain torch, with the same results.

Seeding: an episode is the trial (seed, number), as everywhere in the package. Episode e of environment i
out of N has the number trial_start + e N + i; `reset(seed=...)` starts again with e = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from snnrl.agents.foraging import LEFT, RIGHT, Foraging
from snnrl.configuration.checks import check, torch_device
from snnrl.configuration.compose import compose
from snnrl.errors import ConfigError
from snnrl.model.draws import Draws
from snnrl.running.schedule import ticks_of

SEEDS = 2**63  # as many as `seed` of a run can have
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

    Raises:
        ConfigError: names a value that is out of bounds, contradicts another or is set elsewhere.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        experiment: str = "food_attraction",
        overrides: Sequence[str] = (),
        continuous: bool = False,
    ) -> None:
        if num_envs < 1:
            raise ConfigError("num_envs", num_envs, "must be at least 1")
        for override in overrides:
            key = override.partition("=")[0].lstrip("+")
            if key in ELSEWHERE:
                raise ConfigError("overrides", override, ELSEWHERE[key])
        self.config = compose(f"+experiment={experiment}", *overrides)
        check(self.config)
        self.device = torch_device(self.config.device)
        coding, _ = self.config.body()
        self.num_envs, self.continuous = num_envs, continuous
        self.length = ticks_of(self.config.seconds, coding.tick)  # ticks
        sensors = 2 * len(coding.ranges) + len(coding.touches)
        self.single_observation_space = spaces.Box(0.0, 1.0, (sensors,), np.float32)
        self.single_action_space = (
            spaces.Box(coding.slow, coding.fast, (2,), np.float32) if continuous else spaces.Discrete(RIGHT + 1)
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._bounds = (np.float32(coding.slow), np.float32(coding.fast)) if continuous else (LEFT, RIGHT)
        self.episode = -1
        self.ticks = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin the next episode of all environments, or with a seed the first one.

        Without a seed ever given, one is drawn from the operating system. `options` has no meaning.
        Info holds `trial`, the trials' numbers.
        """
        super().reset(seed=seed)
        self.episode = 0 if seed is not None else self.episode + 1
        first = self.config.trial_start + self.episode * self.num_envs
        trials = torch.arange(first, first + self.num_envs, device=self.device)
        self.foraging = Foraging(self.config, Draws(int(self.np_random_seed or 0) % SEEDS, trials))
        self.ticks = 0
        return self._observe(), {"trial": trials.cpu().numpy(), "_trial": np.ones(self.num_envs, dtype=bool)}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control tick; see `VectorEnv`.

        Raises:
            ValueError: if an action is outside the action space.
        """
        never = np.zeros(self.num_envs, dtype=bool)
        if self.ticks == self.length:
            observation, info = self.reset()
            return observation, np.zeros(self.num_envs), never, never.copy(), info
        reward = self.foraging.step(self._wheels(actions)).cpu().numpy()
        self.ticks += 1
        return self._observe(), reward, never, np.full(self.num_envs, self.ticks == self.length), {}

    def _observe(self) -> np.ndarray:
        ranges, touched = self.foraging.ranges(), self.foraging.touched
        return torch.cat([ranges.flatten(1), touched], 1).float().cpu().numpy()

    def _wheels(self, actions: np.ndarray) -> Tensor:
        actions = np.asarray(actions, self.action_space.dtype)
        least, most = self._bounds
        inside = actions.shape == self.action_space.shape and least <= actions.min() and actions.max() <= most
        if not inside:  # which the space itself would be slower to say
            raise ValueError(f"action={actions}: must be in {self.action_space}")
        given = torch.as_tensor(actions, device=self.device)
        return given.double() if self.continuous else self.foraging.wheels(given)


class ForagingEnv(gymnasium.Env):
    """One robot in its world: `ForagingVectorEnv` with N = 1, and its arguments."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self, experiment: str = "food_attraction", overrides: Sequence[str] = (), continuous: bool = False
    ) -> None:
        self.batch = ForagingVectorEnv(1, experiment, overrides, continuous)
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin the next episode, or with a seed the first one; see `ForagingVectorEnv.reset`."""
        super().reset(seed=seed)
        observation, info = self.batch.reset(seed=seed, options=options)
        return observation[0], {"trial": int(info["trial"][0])}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control tick; see `gymnasium.Env`."""
        observation, reward, terminated, truncated, _ = self.batch.step(np.asarray(action)[None])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), {}


for _name, _experiment in {"Foraging": "food_attraction", "FoodContainers": "dual_learning"}.items():
    gymnasium.register(
        f"snnrl/{_name}-v0",
        entry_point="snnrl.environments:ForagingEnv",
        vector_entry_point="snnrl.environments:ForagingVectorEnv",
        kwargs={"experiment": _experiment},
    )
