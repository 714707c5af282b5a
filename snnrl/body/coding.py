"""Between world and network: sensor values to currents, spike counts to wheel speeds."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from snnrl.model.draws import poisson, poisson_of_means, poisson_thresholds, stream
from snnrl.model.network import Network
from snnrl.schema import CodingConfig

PRECISION = torch.float64


def lead_of(left: Tensor, right: Tensor) -> Tensor:
    """Which wheel is the fast one, by the spikes of the motors (winner takes all): 1 the left, -1 the right, 0 none."""
    return torch.where(left > right, 1.0, torch.where(left < right, -1.0, 0.0))


def share_of(left: Tensor, right: Tensor) -> Tensor:
    """The same without a winner: by how much the left motor's share of all spikes is the larger one, from -1 to 1."""
    spikes = left + right
    return (left - right) / torch.where(spikes > 0, spikes, 1)


def wheel_speeds(lead: Tensor, slow: float, fast: float) -> tuple[Tensor, Tensor]:
    """Speeds of the left and the right wheel (cm/s).

    Args:
        lead: 1 where the left wheel is the fast one (a turn to the right), -1 where the right one is,
            0 for straight ahead at the speed between; or anything between these.
    """
    middle, half = 0.5 * (fast + slow), 0.5 * (fast - slow)
    return middle + half * lead, middle - half * lead


class Coding(nn.Module):
    """Encodes what the robot senses, explores, and decodes its wheel speeds.

    A range pulse is given at every tick for 1 ms, gain * Poisson(mean * the sensor's value), drawn per neuron; a touch
    pulse at the tick of contact (thesis 3.5). The gain may be one of the mean instead of the counts. Besides, or
    instead, a range sensor may give a constant current in every ms, in proportion to its value. One motor, drawn
    for each tick, gets a current of gain * Poisson(mean) in every ms: exploration (thesis 3.11). It is drawn per
    neuron, for every ms or once for all of a tick.

    Args:
        network: whose groups it drives and reads.
        config: which groups those are, and the numbers.

    Buffers:
        decoded: int64 [B, 2], spikes of the left and right motors that earlier ticks have used up.
    """

    decoded: Tensor
    touch_thresholds: Tensor
    exploration_thresholds: Tensor

    def __init__(self, network: Network, config: CodingConfig) -> None:
        super().__init__()
        self.config, self.tick = config, config.tick
        names = list(network.groups)
        self.motors = (config.motors.left, config.motors.right)
        self.motor_groups = [names.index(motor) for motor in self.motors]
        zeros = torch.zeros(network.trials, 2, dtype=torch.int64, device=network.device)
        self.register_buffer("decoded", zeros)
        self.range_mean, self.range_gain = self._pulse(config.range_mean, config.range_gain)
        self.touch_mean, self.touch_gain = self._pulse(config.touch_mean, config.touch_gain)
        for name, mean in {"touch": self.touch_mean, "exploration": config.exploration}.items():
            thresholds = poisson_thresholds(mean).to(network.device)
            self.register_buffer(f"{name}_thresholds", thresholds, persistent=False)

    def _pulse(self, mean: float, gain: float) -> tuple[float, float]:
        """The mean of a pulse's counts, and the current of each."""
        return (mean, gain) if self.config.gain_acts_on == "counts" else (gain * mean, 1.0)

    @property
    def held(self) -> bool:
        """Whether exploration is drawn once for all ms of a tick."""
        return self.config.exploration_drawn == "each_tick"

    def decode(self, network: Network) -> Tensor:
        """Wheel speeds (cm/s), float64 [B, 2] left and right, from the spikes since the last call."""
        count = torch.stack([network.spike_count[:, k] for k in self.motor_groups], 1)
        left, right = (count - self.decoded).double().unbind(1)
        self.decoded.copy_(count)
        lead = share_of(left, right) if self.config.wheels == "share" else lead_of(left, right).double()
        return torch.stack(wheel_speeds(lead, self.config.slow, self.config.fast), 1)

    def encode(self, network: Network, values: Mapping[str, Tensor], touched: Mapping[str, Tensor]) -> Tensor:
        """The coming tick's currents, [tick, B, N].

        Args:
            values: range sensors, float64 [B, 2] (left, right) in [0, 1].
            touched: touch sensors, bool [B].
        """
        draws, dtype, config = network.draws, network.dtype, self.config
        times = network.time + torch.arange(self.tick, device=network.device)
        now = times[:1]
        current = network.pending.new_zeros(self.tick, network.trials, network.size)
        for name, pair in config.ranges.items():
            for group, value in zip((pair.left, pair.right), values[name].unbind(1), strict=True):
                bits = draws.bits(stream("range", group), now, network.groups[group].size)[0]
                pulse = poisson_of_means(bits, self.range_mean * value, self.range_mean).to(dtype)
                current[0, :, network.groups[group].span] += self.range_gain * pulse
                if config.range_current:
                    current[:, :, network.groups[group].span] += (config.range_current * value).to(dtype)[:, None]
        for name, group in config.touches.items():
            bits = draws.bits(stream("touch", group), now, network.groups[group].size)[0]
            pulse = (poisson(bits, self.touch_thresholds) * touched[name][:, None]).to(dtype)
            current[0, :, network.groups[group].span] += self.touch_gain * pulse
        right = draws.uniform(stream("exploring side"), now, 1)[0] >= 0.5
        drawn = now if self.held else times
        for group, explores in zip(self.motors, (~right, right), strict=True):
            bits = draws.bits(stream("exploration", group), drawn, network.groups[group].size)
            exploration = poisson(bits, self.exploration_thresholds) * explores
            current[:, :, network.groups[group].span] += config.exploration_gain * exploration.to(dtype)
        return current
