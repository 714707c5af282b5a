"""Loggers besides TensorBoard: what they are told of a run, and of one that is killed; MLflow's runs, read back."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SMALL_TASK, compose_config
from test_extras import without_extras

from snnrl.errors import ConfigError
from snnrl.recording.logger import About, Histogram
from snnrl.running.job import perform
from snnrl.running.loggers import loggers_of

RUN = (
    "+experiment=food_attraction",
    "trials=3",
    "seconds=21",
    "threads=1",
    "record.every=3",
    "record.tensorboard=false",
)
WEIGHT = "weight, mV/left food to right motor"


class Remembering:
    """A logger of one's own: remembers all that it was told, and ends the run when told to."""

    def __init__(self) -> None:
        self.told: list[tuple[str, Any, Any]] = []
        self.stop_at = 0

    def begin(self, about: About, saved: int | str | None) -> None:
        self.about, self.saved = about, saved

    def scalars(self, values: Any, step: int) -> None:
        if step == self.stop_at:
            raise KeyboardInterrupt
        self.told.append(("scalars", values, step))

    def histograms(self, values: Any, step: int) -> None:
        self.told.append(("histograms", values, step))

    def figure(self, tag: str, pixels: np.ndarray, step: int) -> None:
        self.told.append(("figure", tag, step))

    def text(self, tag: str, text: str, step: int) -> None:
        self.told.append(("text", tag, text))

    def flush(self) -> int:
        return len(self.told)

    def end(self) -> None:
        self.told.append(("end", None, None))

    def of(self, kind: str) -> list[tuple[Any, Any]]:
        return [(what, step) for name, what, step in self.told if name == kind]


@pytest.fixture
def mine(monkeypatch: pytest.MonkeyPatch) -> Remembering:
    """The logger that `record.loggers=[test_loggers:make]` names."""
    made = Remembering()
    monkeypatch.setitem(globals(), "make", lambda: made)
    return made


def test_a_logger_of_ones_own_is_told_everything(tmp_path: Path, mine: Remembering) -> None:
    perform(compose_config(*RUN, f"record.loggers=[{__name__}:make]"), tmp_path)
    series = np.load(tmp_path / "series.npz")
    assert mine.saved is None
    assert [step for _, step in mine.of("scalars")] == [3, 6, 9, 12, 15, 18, 21]
    place = series["projections"].tolist().index("left_food_to_right_motor")
    assert [values[WEIGHT] for values, _ in mine.of("scalars")] == pytest.approx(
        series["weight"][:, :, place].mean(1).tolist()
    )
    ((histograms, step),) = mine.of("histograms")
    weights = np.load(tmp_path / "weights.npz")["left_food_to_right_motor"]
    assert step == 21
    np.testing.assert_allclose(
        np.sort(histograms["weights of all trials, mV/left food to right motor"].values),
        np.sort(weights[np.isfinite(weights)]),
    )
    assert [what for what, _ in mine.of("figure")] == [
        f"trial 0/{name}" for name in ("last 10 s in the arena", "last spikes", "weights")
    ]
    assert mine.told[-1][0] == "end"
    assert mine.about.folder == tmp_path
    assert mine.about.metrics == ["behaviour/food, items", "behaviour/fraction correct"]


def test_it_is_told_how_trials_differ(tmp_path: Path, mine: Remembering) -> None:
    """Quantiles of what each trial's series says, by the roles of its projections."""
    perform(compose_config(*RUN, f"record.loggers=[{__name__}:make]"), tmp_path)
    series = np.load(tmp_path / "series.npz")
    names = series["projections"].tolist()
    pair = [names.index(name) for name in ("left_food_to_right_motor", "right_food_to_left_motor")]
    for tag, values in (
        ("behaviour, spread over trials/collection rate, items per s", series["collection_rate"]),
        ("weight of role, mV, spread over trials/food attraction", series["weight"][:, :, pair].mean(2)),
    ):
        for name, part in (("10 %", 0.1), ("median", 0.5), ("90 %", 0.9)):
            told = [scalars[f"{tag}, {name}"] for scalars, _ in mine.of("scalars")]
            assert told == pytest.approx(np.quantile(values, part, axis=1).tolist(), rel=1e-5)
    bands = [chart for charts in mine.about.charts.values() for chart in charts if chart.band]
    assert {tag for chart in bands for tag in chart.tags} <= mine.of("scalars")[0][0].keys()
    assert len(bands) == 4  # the rate, and three roles


def test_a_single_trial_has_no_spread(tmp_path: Path, mine: Remembering) -> None:
    perform(compose_config(*RUN, "trials=1", f"record.loggers=[{__name__}:make]"), tmp_path)
    assert not [tag for scalars, _ in mine.of("scalars") for tag in scalars if "spread" in tag]
    assert not [chart for charts in mine.about.charts.values() for chart in charts if chart.band]


def test_names_are_for_people(tmp_path: Path, mine: Remembering) -> None:
    for name, options in (
        ("robot", RUN),
        ("task", ("+experiment=distal_reward", *SMALL_TASK, "trials=2", "seconds=2", "record.every=1")),
    ):
        (tmp_path / name).mkdir()
        perform(compose_config(*options, f"record.loggers=[{__name__}:make]"), tmp_path / name)
        tags = {tag for scalars, _ in mine.of("scalars") for tag in scalars}
        assert len(tags) > 10
        assert not [tag for tag in tags if "_" in tag]
        assert not [title for charts in mine.about.charts.values() for chart in charts if "_" in (title := chart.title)]


def test_every_run_has_hyperparameters_a_task_too(tmp_path: Path, mine: Remembering) -> None:
    options = ("+experiment=distal_reward", *SMALL_TASK, "trials=2", "seconds=2", "record.every=1")
    config = compose_config(*options, f"record.loggers=[{__name__}:make]")
    assert config.network.dopamine is not None
    perform(config, tmp_path)
    choices = mine.about.choices
    assert (choices["experiment"], choices["robot"], choices["trials"]) == ("distal_reward", "learning", 2)
    assert choices["network.dopamine.tau"] == config.network.dopamine.tau
    assert choices["network.plasticity.potentiation"] == config.network.plasticity.potentiation
    metrics = ["task/rewards", "task/mean weight, mV", "task/weight of the watched synapse, mV"]
    assert mine.about.metrics == metrics
    assert set(metrics) <= mine.of("scalars")[-1][0].keys()


def test_an_alarm_is_a_text(tmp_path: Path, mine: Remembering) -> None:
    absurd = ["network.plasticity.potentiation=10", "network.homeostasis=null", "network.dopamine.baseline=0.01"]
    perform(compose_config(*RUN, "seconds=60", *absurd, f"record.loggers=[{__name__}:make]"), tmp_path)
    assert "alarm: saturated" in [tag for tag, _ in mine.of("text")]


def test_a_run_that_goes_on_says_where_from(tmp_path: Path, mine: Remembering) -> None:
    config = compose_config(*RUN, "checkpoint.every=6", f"record.loggers=[{__name__}:make]")
    mine.stop_at = 15
    with pytest.raises(KeyboardInterrupt):
        perform(config, tmp_path)
    mine.stop_at = 0
    told = [step for _, step in mine.of("scalars")]
    perform(config, tmp_path)
    assert told == [3, 6, 9, 12]
    assert mine.saved == 4
    assert [step for _, step in mine.of("scalars")] == [*told, 15, 18, 21]


@pytest.mark.parametrize("name", ["nothing", "nowhere:make", "test_loggers:missing"])
def test_a_logger_that_is_not_there_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"record\.loggers"):
        loggers_of(compose_config(*RUN, f"record.loggers=[{name}]").record)


def test_mlflow_that_is_not_installed_is_refused_before_a_folder_is_made(tmp_path: Path) -> None:
    run = "from snnrl.command.main import main; main()"
    words = ("run", "experiment=food_attraction", "trials=1", "seconds=1", "record.loggers=[mlflow]")
    done = without_extras(tmp_path, run, *words)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == (
        'snnrl.run: record.loggers=mlflow: needs mlflow, matplotlib, PIL, scipy: pip install "snnrl[mlflow]"'
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("values", [[0.5, 1.0, 3.9], [-1.0, 5.0]])
def test_bins_hold_every_weight(values: list[float]) -> None:
    counts, edges = Histogram(np.array(values), 0.0, 4.0).bins()
    assert counts.sum() == len(values)
    assert edges[0] == min(0.0, *values)
    assert edges[-1] == max(4.0, *values)


@pytest.fixture
def client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """MLflow's, of files in a folder."""
    monkeypatch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", (tmp_path / "tracked").as_uri())
    return mlflow.MlflowClient()


def points(client: Any, run: str, tag: str) -> list[tuple[int, float]]:
    return [(point.step, point.value) for point in client.get_metric_history(run, tag)]


def test_mlflow_has_the_run(tmp_path: Path, client: Any) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    overrides = ["+experiment=food_attraction", "network.dopamine.tau=40"]
    config = compose_config(*RUN, "network.dopamine.tau=40", "record.loggers=[mlflow]")
    summary = perform(config, folder, overrides)
    experiment = client.get_experiment_by_name("food_attraction")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.params["network.dopamine.tau"] == "40.0"
    assert run.data.params["robot"] == "learning"
    assert run.data.params["trials"] == "3"
    assert run.data.metrics["behaviour/food items"] == pytest.approx(summary["results"]["food_mean"])
    series = np.load(folder / "series.npz")
    rate = points(client, run.info.run_id, "behaviour/collection rate items per s")
    assert [step for step, _ in rate] == [3, 6, 9, 12, 15, 18, 21]
    assert [value for _, value in rate] == pytest.approx(series["collection_rate"].mean(1).tolist())
    artifacts = {file.path for file in client.list_artifacts(run.info.run_id)}
    assert artifacts == {"config.yaml", "trials.csv", "trial 0", "weights of all trials mV"}
    inside = "weights of all trials mV/left food to right motor"
    assert [file.path for file in client.list_artifacts(run.info.run_id, inside)] == [f"{inside}/21.json"]
    pictures = {file.path for file in client.list_artifacts(run.info.run_id, "trial 0")}
    assert pictures == {f"trial 0/{name}" for name in ("last 10 s in the arena", "last spikes", "weights")}
    table = client.download_artifacts(run.info.run_id, "trials.csv", os.fspath(tmp_path))
    assert Path(table).read_bytes() == (folder / "trials.csv").read_bytes()


@pytest.mark.parametrize("every", [0, 6])
def test_mlflow_has_a_run_that_was_stopped_once_and_without_a_seam(
    tmp_path: Path, client: Any, mine: Remembering, every: int
) -> None:
    loggers = f"record.loggers=[mlflow,{__name__}:make]"
    config = compose_config(*RUN, f"checkpoint.every={every}", loggers)
    mine.stop_at = 15
    folder = tmp_path / "run"
    folder.mkdir()
    with pytest.raises(KeyboardInterrupt):
        perform(config, folder)
    mine.stop_at = 0
    perform(config, folder)
    (run,) = client.search_runs([client.get_experiment_by_name("food_attraction").experiment_id])
    assert run.info.status == "FINISHED"
    for tag in run.data.metrics:
        assert [step for step, _ in points(client, run.info.run_id, tag)] == [3, 6, 9, 12, 15, 18, 21], tag


def test_what_mlflow_refuses_ends_the_run_in_a_line(tmp_path: Path, client: Any, monkeypatch: Any) -> None:
    monkeypatch.delenv("MLFLOW_ALLOW_FILE_STORE")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", (tmp_path / "refused").as_uri())
    with pytest.raises(OSError, match=r"record\.loggers=mlflow: .*MLFLOW_ALLOW_FILE_STORE"):
        perform(compose_config(*RUN, "record.loggers=[mlflow]"), tmp_path)
