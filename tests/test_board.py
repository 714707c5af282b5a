"""The real TensorBoard on small runs: what its pages are given, over HTTP, and how one looks in a browser."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SMALL_TASK, compose_config
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.metadata import parse_experiment_plugin_data, parse_session_start_info_plugin_data

from snnrl.recording.probes import ELIGIBILITY, readable
from snnrl.running.job import perform

SWEEP = {"a": ["network.dopamine.tau=25", "seed=3"], "b": ["network.dopamine.tau=40", "seed=3"]}
RUN = ["+experiment=dual_learning", "trials=2", "trial_start=7", "seconds=30", "threads=1"]
RECORD = ["record.every=2", "record.histograms=10", "record.pictures=20"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs as a sweep leaves them."""
    folder = tmp_path_factory.mktemp("runs")
    for name, overrides in SWEEP.items():
        (folder / name).mkdir()
        perform(compose_config(*RUN, *RECORD, *overrides), folder / name, [RUN[0], *RECORD, *overrides])
    return folder


@pytest.fixture(scope="module")
def address(runs: Path) -> Iterator[str]:
    """Of a TensorBoard that has read both runs."""
    script = str(Path(sys.executable).with_name("tensorboard"))
    command = [script, "--logdir", str(runs), "--host", "127.0.0.1", "--port", "0", "--load_fast", "false"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        try:
            assert server.stderr is not None
            found = next(match[0] for line in server.stderr if (match := re.search(r"http://[\d.]+:\d+", line)))
            until = time.monotonic() + 60
            while set(get(found, "images/tags")) != set(SWEEP) and time.monotonic() < until:
                time.sleep(0.2)
            yield found
        finally:
            server.terminate()


def get(address: str, route: str, body: Any = None, **query: Any) -> Any:
    """What a plugin answers: JSON, or the bytes of an image."""
    text = f"{address}/data/plugin/{route}" + (f"?{urllib.parse.urlencode(query)}" if query else "")
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(text, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=30) as answer:
        content = answer.read()
    return json.loads(content) if answer.headers["Content-Type"].startswith("application/json") else content


def test_scalars_are_those_of_the_series(runs: Path, address: str) -> None:
    tags = get(address, "scalars/tags")
    assert set(tags) == {"a", "b"}
    series = np.load(runs / "a" / "series.npz")
    names, groups = series["projections"].tolist(), series["groups"].tolist()
    rates = series["collection_rate"]
    weight, eligibility, firing = (series[name].mean(1) for name in ("weight", "eligibility", "firing_rate"))
    pair = [names.index(name) for name in ("left_food_to_right_motor", "right_food_to_left_motor")]
    expected = {
        "behaviour/collection rate, items per s": rates.mean(1),
        "behaviour/food, items": np.cumsum(rates.mean(1) * np.diff(series["time"], prepend=0.0)),
        "dopamine/mean level, uM": series["dopamine"].mean(1),
        "weight of role, mV/food attraction": weight[:, pair].mean(1),
        "behaviour, spread over trials/collection rate, items per s, 90 %": np.quantile(rates, 0.9, axis=1),
        **{f"weight, mV/{readable(name)}": weight[:, k] for k, name in enumerate(names)},
        **{f"{ELIGIBILITY}/{readable(name)}": eligibility[:, k] for k, name in enumerate(names)},
        **{f"firing rate, Hz/{readable(name)}": firing[:, k] for k, name in enumerate(groups)},
    }
    assert set(tags["a"]) >= {*expected, "behaviour/fraction correct"}
    assert not any(tag.startswith("alarms") or "_" in tag for tag in tags["a"])
    for tag, values in expected.items():
        points = get(address, "scalars/scalars", run="a", tag=tag)
        assert [step for _, step, _ in points] == np.round(series["time"]).tolist()
        np.testing.assert_allclose([value for *_, value in points], values, rtol=1e-4, atol=1e-7, err_msg=tag)


def test_a_taxis_has_its_attraction_against_its_avoidance(address: str) -> None:
    categories = {entry["title"]: entry["chart"] for entry in get(address, "custom_scalars/layout")["category"]}
    assert list(categories) == ["container taxis", "food taxis", "spread over trials"]
    chart = categories["food taxis"][0]
    assert chart["title"] == "food: attraction against avoidance, mean weight (mV)"
    for charts in (categories["container taxis"], categories["food taxis"]):
        for tag in (tag for chart in charts for tag in chart["multiline"]["tag"]):
            found = get(address, "custom_scalars/scalars", run="b", tag=tag)
            assert found["regex_valid"]
            assert [len(points) for points in found["tag_to_events"].values()] == [15]


def test_what_is_spread_over_trials_is_a_band(runs: Path, address: str) -> None:
    categories = {entry["title"]: entry["chart"] for entry in get(address, "custom_scalars/layout")["category"]}
    bands = {chart["title"]: chart["margin"]["series"][0] for chart in categories["spread over trials"]}
    role = bands["weight of role, mV/food attraction: median, 10 to 90 % of trials"]
    tags = get(address, "scalars/tags")["a"]
    for band in bands.values():
        assert {band["value"], band["lower"], band["upper"]} <= set(tags)
    series = np.load(runs / "a" / "series.npz")
    names = series["projections"].tolist()
    pair = [names.index(name) for name in ("left_food_to_right_motor", "right_food_to_left_motor")]
    for place, part in (("value", 0.5), ("lower", 0.1), ("upper", 0.9)):
        points = get(address, "scalars/scalars", run="a", tag=role[place])
        expected = np.quantile(series["weight"][:, :, pair].mean(2), part, axis=1)
        np.testing.assert_allclose([value for *_, value in points], expected, rtol=1e-5)


def test_pictures_and_histograms(runs: Path, address: str) -> None:
    tags = ["trial 7/last 10 s in the arena", "trial 7/last spikes", "trial 7/weights"]
    assert sorted(get(address, "images/tags")["a"]) == tags
    for tag in tags:
        shown = get(address, "images/images", run="a", tag=tag, sample=0)
        assert [entry["step"] for entry in shown] == [20, 30]
        pixels = np.asarray(Image.open(io.BytesIO(get(address, "images/individualImage?" + shown[-1]["query"]))))
        assert pixels.shape[2] == 3
        assert pixels.std() > 10.0
    tag = "weights of all trials, mV/left food to right motor"
    assert tag in get(address, "histograms/tags")["a"]
    histogram = get(address, "histograms/histograms", run="a", tag=tag)
    assert [step for _, step, _ in histogram] == [10, 20, 30]
    weights = np.load(runs / "a" / "weights.npz")["left_food_to_right_motor"]
    assert sum(count for _, _, count in histogram[-1][2]) == np.isfinite(weights).sum()


def test_a_sweep_is_one_table(runs: Path, address: str) -> None:
    columns = get(address, "hparams/experiment", body={})
    names = {info["name"] for info in columns["hparamInfos"]}
    assert names > {"experiment", "robot", "seed", "trials", "seconds", "network.dopamine.tau"}
    assert not [name for name in names if name.startswith("record")]
    metrics = [info["name"]["tag"] for info in columns["metricInfos"]]
    assert metrics == [
        "behaviour/food, items",
        "behaviour/fraction correct",
    ]
    wanted = {"allowedStatuses": ["STATUS_SUCCESS"], "colParams": [], "startIndex": 0, "sliceSize": 10}
    rows = {row["name"]: row for row in get(address, "hparams/session_groups", body=wanted)["sessionGroups"]}
    assert set(rows) == {"a", "b"}
    for name, tau in (("a", 25), ("b", 40)):
        summary = json.loads((runs / name / "summary.json").read_text())
        chosen = {"experiment": "dual_learning", "robot": "learning", "seed": 3, "network.dopamine.tau": tau}
        always = {"trials": 2, "seconds": 30, "network.dopamine.delay": 5, "network.plasticity.weight_max": 4}
        assert rows[name]["hparams"].items() > {**chosen, **always}.items()
        values = {entry["name"]["tag"]: entry["value"] for entry in rows[name]["metricValues"]}
        assert values["behaviour/food, items"] == pytest.approx(summary["results"]["food_mean"])
        assert values["behaviour/fraction correct"] == summary["results"]["correct_fraction"]


def test_a_run_has_one_writer(runs: Path) -> None:
    assert len(list(runs.glob("*/events*"))) == len(list(runs.rglob("events*"))) == len(SWEEP)


def test_any_network_has_a_board(tmp_path: Path) -> None:
    """Without roles, plastic synapses, dopamine, correctness or items."""
    config = compose_config("+experiment=food_attraction", "trials=1", "seconds=3", "threads=1", *RECORD)
    for projection in config.network.projections.values():
        projection.role = ""
    config.robot.learning, config.experiment.correct = False, {}
    config.network.homeostasis = config.network.dopamine = None
    config.body()[1].kinds["food"].count = 0
    perform(config, tmp_path)
    events = EventAccumulator(str(tmp_path)).Reload()
    assert len(events.Tags()["images"]) == 3
    assert "behaviour/food, items" in events.Tags()["scalars"]


def hyperparameters(events: EventAccumulator) -> tuple[dict[str, Any], list[str]]:
    """A run's row in HParams, and the tags of its metrics."""
    begun, about = (events.SummaryMetadata(f"_hparams_/{name}") for name in ("session_start_info", "experiment"))
    row = parse_session_start_info_plugin_data(begun.plugin_data.content).hparams
    told = parse_experiment_plugin_data(about.plugin_data.content).metric_infos
    names = {key: value.string_value or value.number_value for key, value in row.items()}
    return names, [info.name.tag for info in told]


OF_A_TASK = ["task/rewards", "task/mean weight, mV", "task/weight of the watched synapse, mV"]


@pytest.mark.parametrize(
    ("options", "metrics"),
    [
        (["+experiment=food_attraction"], ["behaviour/food, items", "behaviour/fraction correct"]),
        (["+experiment=distal_reward", *SMALL_TASK], OF_A_TASK),
    ],
)
def test_a_run_with_nothing_chosen_is_a_row_too(tmp_path: Path, options: list[str], metrics: list[str]) -> None:
    config = compose_config(*options, "trials=2", "seconds=7", "threads=1")
    perform(config, tmp_path)
    assert config.network.dopamine is not None
    events = EventAccumulator(str(tmp_path)).Reload()
    row, told = hyperparameters(events)
    assert told == metrics
    assert set(metrics) <= set(events.Tags()["scalars"])
    assert row["experiment"] == config.experiment.name
    assert row["network.dopamine.tau"] == config.network.dopamine.tau


def test_a_short_run_has_histograms(tmp_path: Path) -> None:
    config = compose_config("+experiment=food_attraction", "trials=2", "seconds=7", "threads=1")
    perform(config, tmp_path)
    events = EventAccumulator(str(tmp_path)).Reload()
    names = [readable(name) for name, projection in config.network.projections.items() if projection.role]
    assert events.Tags()["histograms"] == [f"weights of all trials, mV/{name}" for name in names]
    for tag in events.Tags()["histograms"]:
        assert [event.step for event in events.Histograms(tag)] == [7]


BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
def test_the_scalars_page_draws_its_charts(tmp_path: Path, address: str) -> None:
    """Curves are there: many pixels of each run's colour, right of where the runs are listed."""
    assert BROWSER is not None
    picture = tmp_path / "page.png"
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1500,1400", "--virtual-time-budget=30000"]
    command += [f"--screenshot={picture}", f"{address}/#scalars"]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    charts = np.asarray(Image.open(picture).convert("RGB")).astype(int)[:, 360:]
    for colour in ((255, 112, 67), (0, 119, 187)):
        assert (np.abs(charts - colour).max(2) < 12).sum() > 200
