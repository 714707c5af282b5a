"""A replayed trial as a file of Neurodata Without Borders: spikes, behaviour, dopamine and rewards."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from snnrl.errors import ConfigError
from snnrl.replay.trial import Recording


def write_nwb(recording: Recording, path: Path, description: str, began: datetime) -> None:
    """Write a recording.

    `units` has a row for each neuron of the network: its `spike_times` (s since the start of the trial), its `group`,
    its `neuron` number in it. The processing module `behavior` holds the robot's `position` (cm, with the conversion to
    m) and `heading` (rad) in every control tick, and how often it touched each kind of object. `dopamine` (uM) is an
    acquisition, and the intervals `rewards` are its transients with their causes.

    Args:
        description: of the trial.
        began: when; times are counted from there.

    Raises:
        ConfigError: pynwb is not installed.
    """
    try:
        from pynwb import NWBHDF5IO, NWBFile, TimeSeries
        from pynwb.behavior import CompassDirection, Position, SpatialSeries
        from pynwb.epoch import TimeIntervals
    except ImportError:
        raise ConfigError("--nwb", "", 'needs pip install "snnrl[nwb]"') from None
    identifier = f"{description}, from {recording.start} ms"
    named = {"session_description": description, "identifier": identifier}
    file = NWBFile(session_start_time=began.astimezone(UTC), **named)
    _add_units(file, recording)
    start, tick = recording.start / 1000, {"rate": 1000.0 / recording.tick}
    at = {"starting_time": start, **tick}
    way, facing = (np.array([scene[key][0].tolist() for scene in recording.scenes]) for key in ("position", "heading"))
    frame = "corner of the torus; x to the right, y up; heading counterclockwise from x"
    meaning = "the robot after its move at the start of every control tick"
    behaviour = file.create_processing_module(name="behavior", description=meaning)
    position = {"data": way, "unit": "meters", "conversion": 0.01}
    behaviour.add(Position(SpatialSeries(name="position", reference_frame=frame, **position, **at)))
    heading = {"data": facing, "unit": "radians"}
    behaviour.add(CompassDirection(SpatialSeries(name="heading", reference_frame=frame, **heading, **at)))
    for name, touches in recording.touches.items():
        behaviour.add(TimeSeries(name=f"touches_{name}", data=touches, unit="items", **at))
    if len(recording.levels):
        level = {"starting_time": start, "rate": 1000.0}
        file.add_acquisition(TimeSeries(name="dopamine", data=recording.levels, unit="uM", **level))
    meaning = "transients of dopamine, from the first release until it has decayed"
    rewards = TimeIntervals(name="rewards", description=meaning)
    rewards.add_column(name="cause", description="what was touched")
    for reward in recording.credit.rewards:
        rewards.add_interval(start_time=reward.start / 1000, stop_time=reward.end / 1000, cause=reward.cause)
    if recording.credit.rewards:
        file.add_time_intervals(rewards)
    with NWBHDF5IO(path, "w") as output:
        output.write(file)


def _add_units(file: Any, recording: Recording) -> None:
    """The neurons and their spikes."""
    file.add_unit_column(name="group", description="of neurons in the network")
    file.add_unit_column(name="neuron", description="counted within its group")
    observed = [[recording.start / 1000, recording.end / 1000]]
    order = np.argsort(recording.neuron, kind="stable")
    edges = np.searchsorted(recording.neuron[order], np.arange(recording.simulation.network.size + 1))
    seconds = recording.time[order] / 1000
    for name, group in recording.simulation.network.groups.items():
        for k in range(group.size):
            low, high = edges[group.start + k : group.start + k + 2]
            file.add_unit(spike_times=seconds[low:high], obs_intervals=observed, group=name, neuron=k)
