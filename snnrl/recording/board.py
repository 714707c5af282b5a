"""TensorBoard: what its pages show of a run, through one writer in the run's folder. Steps are simulated s."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import FileWriter, summary

from snnrl.files import sync
from snnrl.model.synapses import Projection
from snnrl.recording.probes import ELIGIBILITY, WEIGHT

OF_ROLE = "weight of role, mV"
WEIGHTS = "weights of all trials, mV"  # a tag of its own: TensorBoard takes one for one kind of data
BINS = 60


class Board:
    """Writes the events of one run.

    Args:
        folder: of the run.
        followed: the projections whose weights there will be scalars and histograms of.
        metrics: tags of the scalars that are the run's outcome in HParams, where it has a row if there are any.
    """

    def __init__(self, folder: Path, followed: Sequence[Projection] = (), metrics: Sequence[str] = ()) -> None:
        self.folder, self.followed, self.metrics = folder, followed, metrics
        self._writer = FileWriter(str(folder))

    def begin(self, choices: Mapping[str, str | float]) -> None:
        """What stands at the head of a run's events: the layout of its custom scalars, and its row in HParams.

        Args:
            choices: the columns of the row.
        """
        if charts := layout(self.followed):
            self._writer.add_summary(summary.custom_scalars(charts))
        if self.metrics:
            experiment, start, _ = summary.hparams(dict(choices), dict.fromkeys(self.metrics))
            self._writer.add_summary(experiment)
            self._writer.add_summary(start)

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        """All of one moment, by their tags, in one event; and the mean weight of each role."""
        every = {**values, **self._of_roles(values)}
        found = [Summary.Value(tag=tag, simple_value=float(value)) for tag, value in every.items()]
        self._writer.add_summary(Summary(value=found), step)

    def _of_roles(self, values: Mapping[str, float]) -> dict[str, float]:
        roles: dict[str, list[float]] = {}
        for projection in self.followed:
            roles.setdefault(projection.role, []).append(values[f"{WEIGHT}/{projection.name}"])
        return {f"{OF_ROLE}/{role}": sum(means) / len(means) for role, means in roles.items()}

    def histograms(self, step: int) -> None:
        """The weights (mV) of each projection, over all trials, in one event."""
        found = Summary()
        for projection in self.followed:
            weights = projection.weight.double().cpu().numpy()
            weights = weights[np.isfinite(weights)]
            if len(weights):
                most = weights.max() if projection.rule is None else projection.rule.weight_max
                bounds = (min(0.0, weights.min()), max(most, weights.max()))
                counts, edges = np.histogram(weights, BINS, bounds)
                found.MergeFrom(
                    summary.histogram_raw(
                        f"{WEIGHTS}/{projection.name}",
                        min=weights.min(),
                        max=weights.max(),
                        num=len(weights),
                        sum=weights.sum(),
                        sum_squares=weights.dot(weights),
                        bucket_limits=edges[1:].tolist(),
                        bucket_counts=counts.tolist(),
                    )
                )
        self._writer.add_summary(found, step)

    def picture(self, tag: str, pixels: np.ndarray, step: int) -> None:
        """uint8 [height, width, 3]."""
        encoded, (height, width, colours) = io.BytesIO(), pixels.shape
        Image.fromarray(pixels).save(encoded, "PNG", compress_level=1)
        image = Summary.Image(height=height, width=width, colorspace=colours, encoded_image_string=encoded.getvalue())
        self._writer.add_summary(Summary(value=[Summary.Value(tag=tag, image=image)]), step)

    def note(self, tag: str, text: str, step: int) -> None:
        self._writer.add_summary(summary.text(tag, text), step)

    def flush(self) -> int:
        """Have the disk hold all events so far; how many bytes they are.

        Raises:
            OSError: one could not be written.
        """
        self._writer.flush()
        size = 0
        for file in self.folder.glob("events.out.tfevents.*"):
            sync(file)
            size += file.stat().st_size
        return size

    def end(self) -> None:
        """Say that the run is complete, and close the events."""
        if self.metrics:
            self._writer.add_summary(summary.hparams({}, {})[2])
        self._writer.flush()  # unlike close, says so if an event could not be written
        self._writer.close()


def layout(followed: Sequence[Projection]) -> dict[str, dict[str, tuple[str, list[str]]]]:
    """Custom scalars: a category for each taxis, with its attraction against its avoidance."""
    roles = {projection.role for projection in followed}
    categories = {}
    for taxis in sorted({role.removesuffix("_attraction") for role in roles if role.endswith("_attraction")}):
        pair = [f"{taxis}_attraction", f"{taxis}_avoidance"]
        if not roles.issuperset(pair):
            continue
        charts = {f"{taxis}: attraction against avoidance, mean weight (mV)": [f"{OF_ROLE}/{role}" for role in pair]}
        for role in pair:
            names = [projection.name for projection in followed if projection.role == role]
            charts[f"{role}: weight of each projection (mV)"] = [f"{WEIGHT}/{name}" for name in names]
            charts[f"{role}: eligibility of each projection"] = [f"{ELIGIBILITY}/{name}" for name in names]
        categories[f"{taxis} taxis"] = {
            title: ("Multiline", [f"^{re.escape(tag)}$" for tag in tags]) for title, tags in charts.items()
        }
    return categories
