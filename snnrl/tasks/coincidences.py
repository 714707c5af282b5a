"""Coincidences: a postsynaptic spike soon after a presynaptic one, at one synapse that is watched.

Tensors over time are [T, B, ...]; `times` are the ms of a tick, int64 [T].
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from snnrl.model.draws import stream
from snnrl.model.network import Network
from snnrl.model.neurons import NEVER


class Coincidence(nn.Module):
    """Watches one plastic synapse of every trial for a postsynaptic spike soon after a presynaptic one.

    Args:
        network: holds the synapse.
        projection: the synapse is drawn from those of this projection that join two different neurons.
        window: it is a coincidence if the last presynaptic spike is 1 to `window - 1` ms old.
        weight: what the synapse starts with (mV).

    Buffers:
        synapse: int64 [B], its place among the network's synapses.
        last_pre: int64 [B], time of the last presynaptic spike (ms).
        count: int64 [B], coincidences since the start.
    """

    synapse: Tensor
    last_pre: Tensor
    count: Tensor

    def __init__(self, network: Network, projection: str, window: int, weight: float) -> None:
        super().__init__()
        self.window = window
        chosen = network.projections[projection]
        names = list(network.projections)
        first = sum(len(network.projections[name].weight) for name in names[: names.index(projection)])
        drawn = network.draws.at_start(stream("chosen synapse"), 1)[:, 0]
        usable = chosen.pre_index != chosen.post_index if chosen.pre == chosen.post else chosen.trial >= 0
        places = []
        for trial in range(network.trials):
            mine = ((chosen.trial == trial) & usable).nonzero()[:, 0]
            assert len(mine), "a projection without synapses"
            places.append(first + mine[int(drawn[trial] * len(mine))])
        self.register_buffer("synapse", torch.stack(places))
        self.register_buffer("last_pre", torch.full_like(self.synapse, NEVER))
        self.register_buffer("count", torch.zeros_like(self.synapse))
        network.synapses.weight[self.synapse] = weight

    def observe(self, network: Network, fired: Tensor, times: Tensor) -> Tensor:
        """Coincidences in spikes bool [T, B, N]: bool [T, B]."""
        trials = torch.arange(network.trials, device=fired.device)
        ends = (network.synapses.pre[self.synapse], network.synapses.post[self.synapse])
        pre, post = (fired[:, trials, end % network.size] for end in ends)
        last = torch.where(pre, times[:, None], self.last_pre).cummax(0).values
        elapsed = times[:, None] - last
        found = post & (elapsed > 0) & (elapsed < self.window)
        self.last_pre.copy_(last[-1])
        self.count += found.sum(0)
        return found
