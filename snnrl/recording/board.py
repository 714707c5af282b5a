"""TensorBoard: the logger that there is unless one says otherwise, one writer in the run's folder."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary
from torch.utils.tensorboard import FileWriter, summary

from snnrl.files import sync
from snnrl.recording.events import keep_events
from snnrl.recording.logger import About, Chart, Histogram


class Board:
    """Writes the events of one run; see `snnrl.recording.logger.Logger`.

    They begin with the layout of the custom scalars, and the run's row in HParams.
    """

    def begin(self, about: About, saved: int | str | None) -> None:
        self._about = about
        keep_events(about.folder, int(saved or 0))
        self._writer = FileWriter(str(about.folder))
        if saved is not None:
            return
        if about.charts:
            self._writer.add_summary(summary.custom_scalars(layout(about.charts)))
        if about.metrics:
            experiment, start, _ = summary.hparams(dict(about.choices), dict.fromkeys(about.metrics))
            self._writer.add_summary(experiment)
            self._writer.add_summary(start)

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        found = [Summary.Value(tag=tag, simple_value=float(value)) for tag, value in values.items()]
        self._writer.add_summary(Summary(value=found), step)

    def histograms(self, values: Mapping[str, Histogram], step: int) -> None:
        found = Summary()
        for tag, histogram in values.items():
            counts, edges = histogram.bins()
            found.MergeFrom(
                summary.histogram_raw(
                    tag,
                    min=histogram.values.min(),
                    max=histogram.values.max(),
                    num=len(histogram.values),
                    sum=histogram.values.sum(),
                    sum_squares=histogram.values.dot(histogram.values),
                    bucket_limits=edges[1:].tolist(),
                    bucket_counts=counts.tolist(),
                )
            )
        self._writer.add_summary(found, step)

    def figure(self, tag: str, pixels: np.ndarray, step: int) -> None:
        encoded, (height, width, colours) = io.BytesIO(), pixels.shape
        Image.fromarray(pixels).save(encoded, "PNG", compress_level=1)
        image = Summary.Image(height=height, width=width, colorspace=colours, encoded_image_string=encoded.getvalue())
        self._writer.add_summary(Summary(value=[Summary.Value(tag=tag, image=image)]), step)

    def text(self, tag: str, text: str, step: int) -> None:
        self._writer.add_summary(summary.text(tag, text), step)

    def flush(self) -> int:
        """How many bytes the events so far are.

        Raises:
            OSError: one could not be written.
        """
        self._writer.flush()
        size = 0
        for file in self._about.folder.glob("events.out.tfevents.*"):
            sync(file)
            size += file.stat().st_size
        return size

    def end(self) -> None:
        if self._about.metrics:
            self._writer.add_summary(summary.hparams({}, {})[2])
        self._writer.flush()  # unlike close, says so if an event could not be written
        self._writer.close()


def layout(charts: Mapping[str, Sequence[Chart]]) -> dict[str, dict[str, tuple[str, list[str]]]]:
    """Charts as `custom_scalars` takes them: of lines a pattern for each tag, of a band the tags."""

    def shown(chart: Chart) -> tuple[str, list[str]]:
        return ("Margin", list(chart.tags)) if chart.band else ("Multiline", [f"^{re.escape(t)}$" for t in chart.tags])

    return {category: {chart.title: shown(chart) for chart in found} for category, found in charts.items()}
