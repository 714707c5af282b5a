"""MLflow: one of its runs for each run folder, where MLflow's own settings say (MLFLOW_TRACKING_URI and others)."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from mlflow import MlflowClient
from mlflow.entities import Metric, Param
from mlflow.exceptions import MlflowException

from snnrl.recording.logger import About, Histogram

RUN = "mlflow.txt"  # in the run folder: the id of its MLflow run
RESULTS = ("config.yaml", "trials.csv")


class Tracking:
    """Hyperparameters are params, scalars metrics with their steps, and all else artifacts.

    A folder's run goes on in the same MLflow run; points that this has already are not written twice. See
    `snnrl.recording.logger.Logger`.
    """

    def begin(self, about: About, saved: int | str | None) -> None:
        """Raises OSError with what MLflow says if it cannot be reached, or refuses."""
        self._folder = about.folder
        try:
            self._client = MlflowClient()
            self._run = self._found() or self._made(about)
            metrics = self._client.get_run(self._run).data.metrics
            self._last = {tag: max(point.step for point in self._history(tag)) for tag in metrics}
        except MlflowException as error:
            raise OSError(f"record.loggers=mlflow: {error.message}") from error

    def _found(self) -> str:
        file = self._folder / RUN
        return file.read_text() if file.exists() else ""

    def _made(self, about: About) -> str:
        made = self._client.create_run(self._experiment(about.name), run_name=str(about.folder))
        params = [Param(allowed(key), str(value)) for key, value in about.choices.items()]
        self._client.log_batch(made.info.run_id, params=params)
        (self._folder / RUN).write_text(made.info.run_id)
        return str(made.info.run_id)

    def _experiment(self, name: str) -> str:
        """Which another process may make at the same time."""
        try:
            return self._client.create_experiment(name)
        except MlflowException:
            found = self._client.get_experiment_by_name(name)
            if found is None:
                raise
            return str(found.experiment_id)

    def _history(self, tag: str) -> list[Metric]:
        return list(self._client.get_metric_history(self._run, tag))

    def scalars(self, values: Mapping[str, float], step: int) -> None:
        now = round(1000 * time.time())
        found = [Metric(allowed(tag), value, now, step) for tag, value in values.items()]
        new = [metric for metric in found if metric.step > self._last.get(metric.key, -1)]
        self._client.log_batch(self._run, metrics=new)

    def histograms(self, values: Mapping[str, Histogram], step: int) -> None:
        """Counts and edges, as JSON."""
        for tag, histogram in values.items():
            counts, edges = histogram.bins()
            content = {"counts": counts.tolist(), "edges": edges.tolist()}
            self._client.log_dict(self._run, content, f"{allowed(tag)}/{step}.json")

    def figure(self, tag: str, pixels: np.ndarray, step: int) -> None:
        self._client.log_image(self._run, pixels, artifact_file=f"{allowed(tag)}/{step}.png")

    def text(self, tag: str, text: str, step: int) -> None:
        self._client.log_text(self._run, text, f"{allowed(tag)}/{step}.txt")

    def flush(self) -> str:
        """The id of the MLflow run, which has all already."""
        return self._run

    def end(self) -> None:
        for path in (Path(self._folder, name) for name in RESULTS):
            if path.exists():
                self._client.log_artifact(self._run, str(path))
        self._client.set_terminated(self._run)


def allowed(tag: str) -> str:
    """A tag without what MLflow takes in no name, as commas."""
    return re.sub(r"[^\w\-. /]", "", tag)
