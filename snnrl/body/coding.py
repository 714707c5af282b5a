"""Between world and network: sensor values to currents, spike counts to wheel speeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from snnrl.model.draws import poisson, poisson_of_means, poisson_thresholds, stream
from snnrl.model.network import Network


@dataclass(frozen=True)
class Pulse:
    """A transient current: for 1 ms, gain * Poisson(mean), drawn per neuron (thesis 3.5)."""

    mean: float
    gain: float


def wheel_speeds(lead: Tensor, slow: float, fast: float) -> Tensor:
    """Speeds of the left and the right wheel (cm/s), float64 [B, 2].

    Args:
        lead: [B], 1 where the left wheel is the fast one (a turn to the right), -1 where the right one is,
            0 for straight ahead at the speed between.
    """
    middle, half = 0.5 * (fast + slow), 0.5 * (fast - slow)
    return torch.stack([middle + half * lead.double(), middle - half * lead.double()], 1)


class Coding(nn.Module):
    """Encodes what the robot senses, explores, and decodes its wheel speeds.

    Args:
        network: whose groups it drives and reads.
        ranges: the left and right groups of each of the world's range sensors.
        touches: the group of each of the world's touch sensors.
        motors: the left and right motor groups, read out by winner takes all.
        range_pulse: given at every tick, its mean multiplied by the sensor's value.
        touch_pulse: given at the tick of contact.
        exploration: mean of the Poisson current per ms that one randomly drawn motor gets for a whole
            tick (thesis 3.11).
        slow, fast: the wheel speeds to choose between, cm/s.
        tick: ms.

    Buffers:
        decoded: int64 [B, 2], spikes of the left and right motors that earlier ticks have used up.
    """

    decoded: Tensor
    touch_thresholds: Tensor
    exploration_thresholds: Tensor

    def __init__(
        self,
        network: Network,
        ranges: Mapping[str, tuple[str, str]],
        touches: Mapping[str, str],
        motors: tuple[str, str],
        range_pulse: Pulse,
        touch_pulse: Pulse,
        exploration: float,
        slow: float,
        fast: float,
        tick: int,
    ) -> None:
        super().__init__()
        self.ranges, self.touches, self.motors = dict(ranges), dict(touches), motors
        self.range_pulse, self.touch_pulse, self.exploration = range_pulse, touch_pulse, exploration
        self.slow, self.fast, self.tick = slow, fast, tick
        names = list(network.groups)
        self.motor_groups = [names.index(motor) for motor in motors]
        zeros = torch.zeros(network.trials, 2, dtype=torch.int64, device=network.device)
        self.register_buffer("decoded", zeros)
        for name, mean in {"touch": touch_pulse.mean, "exploration": exploration}.items():
            thresholds = poisson_thresholds(mean).to(network.device)
            self.register_buffer(f"{name}_thresholds", thresholds, persistent=False)

    def decode(self, network: Network) -> Tensor:
        """Wheel speeds (cm/s), float64 [B, 2] left and right, from the spikes since the last call."""
        count = torch.stack([network.spike_count[:, k] for k in self.motor_groups], 1)
        left, right = (count - self.decoded).unbind(1)
        self.decoded.copy_(count)
        return wheel_speeds(torch.sign(left - right), self.slow, self.fast)

    def encode(self, network: Network, values: Mapping[str, Tensor], touched: Mapping[str, Tensor]) -> Tensor:
        """The coming tick's currents, [tick, B, N].

        Args:
            values: range sensors, float64 [B, 2] (left, right) in [0, 1].
            touched: touch sensors, bool [B].
        """
        draws, dtype = network.draws, network.dtype
        times = network.time + torch.arange(self.tick, device=network.device)
        now = times[:1]
        current = network.pending.new_zeros(self.tick, network.trials, network.size)
        for name, pair in self.ranges.items():
            for group, value in zip(pair, values[name].unbind(1), strict=True):
                bits = draws.bits(stream("range", group), now, network.groups[group].size)[0]
                mean = self.range_pulse.mean
                pulse = poisson_of_means(bits, mean * value, mean).to(dtype)
                current[0, :, network.groups[group].span] += self.range_pulse.gain * pulse
        for name, group in self.touches.items():
            bits = draws.bits(stream("touch", group), now, network.groups[group].size)[0]
            pulse = (poisson(bits, self.touch_thresholds) * touched[name][:, None]).to(dtype)
            current[0, :, network.groups[group].span] += self.touch_pulse.gain * pulse
        right = draws.uniform(stream("exploring side"), now, 1)[0] >= 0.5
        for group, explores in zip(self.motors, (~right, right), strict=True):
            bits = draws.bits(stream("exploration", group), times, network.groups[group].size)
            exploration = poisson(bits, self.exploration_thresholds) * explores
            current[:, :, network.groups[group].span] += exploration.to(dtype)
        return current
