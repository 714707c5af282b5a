"""Train an off-the-shelf PPO in the robot's world, and count what it then collects.

    pip install "snnrl[rl]"
    python examples/ppo.py [--environment snnrl/DualLearning-v0] [--steps 100000] [--seed 0]

It learns in eight worlds at once, from the range sensors and touches that the spiking robot has, and is
tested on seeds that it has not seen.
"""

from __future__ import annotations

import argparse

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import snnrl.environments

gymnasium.register_envs(snnrl.environments)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--environment", default="snnrl/FoodAttraction-v0")
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, default=20, help="to test on")
    parser.add_argument("--seconds", type=float, default=200.0, help="of each test trial")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # tensors are too small to be shared out

    training = make_vec_env(
        lambda: gymnasium.make(arguments.environment, overrides=["seconds=140"]), n_envs=8, seed=arguments.seed
    )
    model = PPO("MlpPolicy", training, n_steps=256, batch_size=256, seed=arguments.seed, device="cpu")
    model.learn(arguments.steps)

    testing = gymnasium.make_vec(
        arguments.environment, num_envs=arguments.trials, overrides=[f"seconds={arguments.seconds}"]
    )
    observation, _ = testing.reset(seed=arguments.seed + 1000)
    collected, over = np.zeros(arguments.trials), False
    while not over:
        action, _ = model.predict(observation, deterministic=False)  # chance gets the robot off orbits
        observation, reward, _, truncated, _ = testing.step(action)
        collected += reward
        over = bool(truncated.all())
    rate = collected / arguments.seconds
    print(f"PPO, {arguments.steps} steps of {arguments.environment}, tested on {arguments.trials} trials")
    print(f"  reward   {rate.mean():.3f} (SD {rate.std(ddof=1):.3f}) per s")


if __name__ == "__main__":
    main()
