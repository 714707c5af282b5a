"""Agents without neurons for the robot's body: two that do not learn, two that learn a table.

Every agent decides for a whole batch of trials, each with a table of its own. Random numbers are those of
the trial and the time, so that a trial is the same alone and in any batch.
"""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from snnrl.agents.foraging import LEFT, RIGHT, STRAIGHT
from snnrl.model.draws import Draws, stream
from snnrl.schema import BraitenbergConfig, QLearningConfig, ReinforceConfig, SarsaLambdaConfig

CHOICES = 3


class Agent(Protocol):
    """What decides in each control tick."""

    def act(self, ranges: Tensor, reward: Tensor, time: Tensor) -> Tensor:
        """LEFT, STRAIGHT or RIGHT, int64 [B].

        Args:
            ranges: what the range sensors see now, float64 [B, R, 2] (left, right) in [0, 1].
            reward: for the last choice, float64 [B]; zeros at first.
            time: int64 scalar, ms.
        """


class RandomWalk:
    """Turns to one side or the other at every tick, like the spiking robot when only exploration drives it."""

    def __init__(self, draws: Draws) -> None:
        self.draws = draws

    def act(self, ranges: Tensor, reward: Tensor, time: Tensor) -> Tensor:
        """See `Agent`."""
        side = self.draws.uniform(stream("random walk"), time.view(1), 1)[0, :, 0]
        return torch.where(side < 0.5, LEFT, RIGHT)


class Braitenberg:
    """Turns towards what it senses, straight ahead where it senses nothing (V. Braitenberg, Vehicles, 1984).

    Args:
        draws: owner of the exploration.
        config: share of ticks with a choice at random instead (exploration); it breaks orbits.
    """

    def __init__(self, draws: Draws, config: BraitenbergConfig) -> None:
        self.draws, self.exploration = draws, config.exploration

    def act(self, ranges: Tensor, reward: Tensor, time: Tensor) -> Tensor:
        """See `Agent`."""
        left, right = ranges.sum(1).unbind(1)
        wired = one_hot(torch.sign(right - left).long() + STRAIGHT, CHOICES)
        return epsilon_greedy(wired, self.exploration, self.draws, time)


class _Table:
    """What tabular agents share: states, values and epsilon-greedy choices."""

    def __init__(self, draws: Draws, sensors: int, config: QLearningConfig) -> None:
        self.draws, self.bins = draws, config.bins
        self.rate, self.discount, self.exploration = config.rate, config.discount, config.exploration
        trials = draws.trials
        states = (2 * config.bins + 1) ** sensors
        self.values = torch.zeros(len(trials), states, CHOICES, dtype=torch.float64, device=trials.device)
        self.rows = torch.arange(len(trials), device=trials.device)
        self.last: tuple[Tensor, Tensor] | None = None

    def choose(self, state: Tensor, time: Tensor) -> Tensor:
        """LEFT, STRAIGHT or RIGHT, int64 [B], epsilon-greedy."""
        return epsilon_greedy(self.values[self.rows, state], self.exploration, self.draws, time)


class QLearning(_Table):
    """Tabular Q-learning, epsilon-greedy (Watkins 1989; Sutton and Barto, 2nd ed., 6.5).

    Args:
        draws: owner of all choices at random; its trials are the batch.
        sensors: how many pairs of range sensors there are.
        config: into how many bins each eye's values are cut (nothing sensed is one more state), step size
            (rate), discount per tick, and epsilon (exploration).

    Attributes:
        values: float64 [B, states, choices], zero at first.
    """

    def act(self, ranges: Tensor, reward: Tensor, time: Tensor) -> Tensor:
        """See `Agent`; learns from the last choice before it makes the next."""
        state = states_of(ranges, self.bins)
        if self.last is not None:
            self.learn(*self.last, reward, state)
        choice = self.choose(state, time)
        self.last = state, choice
        return choice

    def learn(self, state: Tensor, choice: Tensor, reward: Tensor, following: Tensor) -> None:
        """Update the value of `choice` in `state`, which earned `reward` and led to the state `following`; all [B]."""
        at = self.rows, state, choice
        target = reward + self.discount * self.values[self.rows, following].amax(1)
        self.values[at] += self.rate * (target - self.values[at])


class SarsaLambda(_Table):
    """Tabular Sarsa(lambda), epsilon-greedy, with replacing traces (Sutton and Barto, 2nd ed., 12.7).

    Args as `QLearning`; `config.trace` is lambda.

    Attributes:
        values, traces: float64 [B, states, choices], zero at first.
    """

    def __init__(self, draws: Draws, sensors: int, config: SarsaLambdaConfig) -> None:
        super().__init__(draws, sensors, config)
        self.trace = config.trace
        self.traces = torch.zeros_like(self.values)

    def act(self, ranges: Tensor, reward: Tensor, time: Tensor) -> Tensor:
        """See `Agent`; makes the next choice before it learns, from what that choice is worth."""
        state = states_of(ranges, self.bins)
        choice = self.choose(state, time)
        if self.last is not None:
            self.learn(*self.last, reward, state, choice)
        self.last = state, choice
        return choice

    def learn(self, state: Tensor, choice: Tensor, reward: Tensor, following: Tensor, chosen: Tensor) -> None:
        """Update all values from `choice` in `state`, its `reward`, and what was `chosen` in `following`; all [B]."""
        at = self.rows, state, choice
        error = reward + self.discount * self.values[self.rows, following, chosen] - self.values[at]
        self.traces *= self.discount * self.trace
        self.traces[at] = 1.0
        self.values += self.rate * error[:, None, None] * self.traces


class Reinforce:
    """REINFORCE with a softmax over a table of preferences, for a life without episodes (Baxter and Bartlett 2001).

    Args:
        draws: owner of all choices; its trials are the batch.
        sensors: how many pairs of range sensors there are.
        config: into how many bins each eye's values are cut, step size (rate), discount per tick of the credit of
            earlier choices, and whether all trials share what each has learnt, and so depend on each other.

    Attributes:
        preferences, traces: float64 [B, states, choices], zero at first.
    """

    def __init__(self, draws: Draws, sensors: int, config: ReinforceConfig) -> None:
        self.draws, self.bins, self.rate, self.discount = draws, config.bins, config.rate, config.discount
        self.shared, trials = config.shared, draws.trials
        states = (2 * config.bins + 1) ** sensors
        self.preferences = torch.zeros(len(trials), states, CHOICES, dtype=torch.float64, device=trials.device)
        self.traces = torch.zeros_like(self.preferences)
        self.rows = torch.arange(len(trials), device=trials.device)

    def act(self, ranges: Tensor, reward: Tensor, time: Tensor) -> Tensor:
        """See `Agent`; learns from what the choices so far have earned before it makes the next."""
        learnt = self.rate * reward[:, None, None] * self.traces
        self.preferences += learnt.sum(0) if self.shared else learnt
        state = states_of(ranges, self.bins)
        chances = self.preferences[self.rows, state].softmax(1)
        lot = self.draws.uniform(stream("choice"), time.view(1), 1)[0]
        choice = (lot >= chances.cumsum(1)[:, :-1]).sum(1)
        self.credit(state, choice, chances)
        return choice

    def credit(self, state: Tensor, choice: Tensor, chances: Tensor) -> None:
        """Fade the traces, and add the gradient of the log of the chance of `choice` in `state`; all [B]."""
        self.traces *= self.discount
        self.traces[self.rows, state] += one_hot(choice, CHOICES) - chances


def states_of(ranges: Tensor, bins: int) -> Tensor:
    """The states of range sensors, int64 [B], from their values [B, R, 2] in [0, 1].

    A pair of sensors of which at most one answers has the states 0 (nothing), 1 to `bins` (left, from far
    to near), and as many more (right).
    """
    level = (ranges * bins).ceil().long()
    pair = level[..., 0] + (level[..., 1] > 0) * (bins + level[..., 1])
    place = (2 * bins + 1) ** torch.arange(ranges.shape[1], device=ranges.device)
    return (pair * place).sum(1)


def epsilon_greedy(values: Tensor, epsilon: float, draws: Draws, time: Tensor) -> Tensor:
    """The best choice of each trial, int64 [B], a share epsilon of them replaced by one of all at random.

    Args:
        values: [B, choices]; among equals one is taken at random.
        epsilon: in [0, 1].
        draws: owner of the random numbers, at `time`, int64 scalar, ms.
    """
    count = values.shape[1]
    lots = draws.uniform(stream("choice"), time.view(1), count + 2)[0]
    ties, strays, other = lots[:, :count], lots[:, count], lots[:, count + 1]
    best = torch.where(values == values.amax(1, keepdim=True), ties, -1.0).argmax(1)
    return torch.where(strays < epsilon, (other * count).long(), best)
