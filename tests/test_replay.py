"""A trial replayed from its run folder, and the explanation of what its rewards did."""

from __future__ import annotations

import copy
import csv
import math
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import (
    RULE,
    SURE,
    compose_config,
    forced,
    make_dopamine,
    make_group,
    make_network,
    make_projection,
    run_each,
)
from labels import faults
from PIL import Image

from snnrl.configuration.builder import build
from snnrl.configuration.compose import load
from snnrl.engines import make_engine
from snnrl.model.homeostasis import Homeostasis
from snnrl.model.network import Network
from snnrl.model.neurons import NEVER
from snnrl.recording.runs import Run
from snnrl.replay import replay
from snnrl.replay.credit import Credit, Ledger, pairs_of
from snnrl.replay.nwb import write_nwb
from snnrl.replay.scenes import draw_credit, draw_raster
from snnrl.replay.trial import Original, Recording, record
from snnrl.running.job import perform
from snnrl.schema import Config

TRIAL, SECONDS, FROM = 22, 5.6, 2.1  # trial 22 finds food at 2.3 s and at 3.6 s
NWB = ["--nwb"] if find_spec("pynwb") else []
HOW_TO = (Path(__file__).parents[1] / "docs" / "replay.md").read_text()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("run")
    sizes = (
        "trials=2",
        f"trial_start={TRIAL - 1}",
        f"seconds={SECONDS}",
        "record.every=0.7",
        "record.tensorboard=false",
    )
    perform(compose_config("+experiment=food_attraction", *sizes, "threads=1"), folder)
    return Run(folder)


@pytest.fixture(scope="module")
def recording(run: Run) -> Recording:
    """The end of the trial, in float32, as it was run."""
    config = replace(load(run.folder / "config.yaml"), trials=1, trial_start=TRIAL)
    original = Original(run.folder, TRIAL)
    made = record(config, 30, 80, original)
    assert original.compared == 6  # at 2.1, 2.8 ... 5.6 s
    return made


@pytest.fixture(scope="module")
def replayed(run: Run) -> Path:
    """What the command line leaves."""
    replay.main([str(run.folder), "--trial", str(TRIAL), "--from", f"{FROM}", "--to", "3", *NWB])
    return run.folder / "replay" / f"trial-{TRIAL}-{FROM:g}-3"


def test_the_replay_ends_as_the_run_did(run: Run, recording: Recording) -> None:
    simulation = recording.simulation
    [row] = [row for row in csv.DictReader((run.folder / "trials.csv").open()) if row["trial"] == str(TRIAL)]
    assert int(row["food"]) == int(simulation.situation.world.touches[0, 0]) >= 2
    for name in run.series["projections"].tolist():
        assert row[name] == f"{float(simulation.network.projections[name].mean_weight()):.6g}"
        weights = simulation.network.projections[name].matrix()[0].coalesce()
        np.testing.assert_array_equal(run.weights[name][1][tuple(weights.indices())], weights.values())


def test_its_spikes_are_the_runs(run: Run, recording: Recording) -> None:
    inside = run.time > recording.start / 1000 + 0.01
    spans = np.diff(run.time)[inside[1:]]
    for name, group in recording.simulation.network.groups.items():
        own = (recording.neuron >= group.start) & (recording.neuron < group.start + group.size)
        edges = np.append(recording.start, np.rint(1000 * run.time[inside]))
        counts, _ = np.histogram(recording.time[own], edges)
        rates = run.firing_rate(name)[inside, 1]
        np.testing.assert_allclose(counts, rates * group.size * spans, rtol=1e-4)


def test_the_pairs_of_spikes_add_up_to_the_eligibility(recording: Recording) -> None:
    credit = recording.credit
    assert [reward.cause for reward in credit.rewards].count("food") >= 2
    assert np.abs(credit.carried).max() > 0.01  # some eligibility is from before
    for reward in credit.rewards:
        parts = [credit.eligibility(k, reward.start) for k in range(len(credit.synapses))]
        total = [decayed.sum() + rest for decayed, rest in parts]
        np.testing.assert_allclose(total, reward.eligibility, rtol=0, atol=1e-12)


def test_the_changes_of_weight_add_up(recording: Recording) -> None:
    for reward in recording.credit.rewards:
        booked = reward.driven + reward.clipped + reward.dampened + reward.rounding
        np.testing.assert_allclose(reward.change, booked, rtol=0, atol=1e-12)
        assert np.abs(reward.rounding).max() < 1e-5
        level = recording.levels[reward.start - recording.start : reward.end - recording.start]
        assert reward.dopamine == pytest.approx(level.sum())


def food_tick(config: Config) -> int:
    """The tick in which the trial's first item is taken."""
    simulation, engine = build(config), make_engine("fused", "cpu", 1)
    while not int(simulation.situation.world.touches[0, 0]):
        simulation.run(engine, 1)
    return int(simulation.network.time) // simulation.situation.coding.tick


def test_dopamine_times_eligibility_is_what_the_network_itself_computes(run: Run) -> None:
    config = load(run.folder / "config.yaml")
    config = replace(config, trials=1, trial_start=TRIAL, dtype="float64", record=replace(config.record, every=100.0))
    nothing = Original(run.folder / "none", TRIAL)
    first = food_tick(config)
    made = record(config, first - 2, first + 10, nothing)
    [reward] = [reward for reward in made.credit.rewards if reward.cause == "food"]
    assert reward.end < made.end
    simulation, engine = build(config), make_engine("fused", "cpu", 1)
    network, tick = simulation.network, simulation.situation.coding.tick
    simulation.run(engine, reward.start // tick)
    synapses, dopamine = network.synapses, network.dopamine
    assert dopamine is not None
    driven = torch.zeros(synapses.plastic, dtype=torch.float64)
    bound = torch.zeros(synapses.plastic, dtype=torch.bool)  # whether the weight ever was at one
    while int(network.time) < reward.end:
        current, sign, _ = simulation.situation.begin(network)
        for ms in range(tick):
            if int(network.time) == reward.end:
                break
            if int(network.time) == reward.start:
                before = synapses.weight[: synapses.plastic].clone()
            network.run(current[ms : ms + 1], sign)
            if int(network.time) > reward.start:
                driven += synapses.eligibility[: synapses.plastic] * dopamine.level
                bound |= synapses.weight[: synapses.plastic] % 4.0 == 0
    after = synapses.weight[: synapses.plastic]
    np.testing.assert_allclose(reward.driven, driven.numpy(), rtol=0, atol=1e-10)
    np.testing.assert_allclose(reward.before, before.numpy(), rtol=0, atol=1e-10)
    np.testing.assert_allclose(reward.after, after.numpy(), rtol=0, atol=1e-10)
    assert np.abs(reward.rounding).max() < 1e-12
    free = ~bound.numpy()
    assert 10 < free.sum() < len(free)
    assert (reward.clipped[free] == 0).all()
    np.testing.assert_allclose(reward.change[free], driven.numpy()[free] + reward.dampened[free], rtol=0, atol=1e-10)
    assert np.abs(reward.clipped).max() > 0.01  # others were at one


def test_what_bounds_and_homeostasis_take_is_booked() -> None:
    weight = torch.tensor([[[0.0, 2.0, 3.99], [1.0, 2.0, 3.0], [1.9, 2.0, 2.1]]], dtype=torch.float64)

    def make() -> Network:
        groups = [make_group("cue", 3), make_group("motor", 3), make_group("dopaminergic", 6)]
        dampening = {"all": Homeostasis(("steering",), 2.0, 0.1, True)}
        return make_network(groups, [make_projection("steering", "cue", "motor", weight)], make_dopamine(), dampening)

    network, ledger = make(), Ledger(make())
    spikes = {("cue", 2): [10], ("motor", 2): [12], ("cue", 0): [14], ("motor", 0): [13]}
    current = forced(network, 210, {**spikes, **{("dopaminergic", k): [20] for k in range(6)}})
    raster, [weights] = run_each("reference", network, current, network.synapses.weight)
    for k in range(0, 210, 70):
        ledger.follow(raster[k : k + 70], 1.0, "food", weights[k + 69])
    ledger.close()
    [reward] = ledger.rewards
    assert (reward.start, reward.end, reward.cause) == (25, 151, "food")
    expected = RULE.potentiation * math.exp(-2 / RULE.tau_plus - 13 / RULE.tau_eligibility)
    assert reward.eligibility[8] == pytest.approx(expected, rel=1e-12)  # cue 2 to motor 2
    np.testing.assert_array_equal(reward.before, weights[24])
    np.testing.assert_allclose(reward.after, weights[150], rtol=0, atol=1e-12)
    booked = reward.driven + reward.clipped + reward.dampened
    np.testing.assert_allclose(reward.change, booked, rtol=0, atol=1e-12)
    assert reward.clipped[0] > 0.01  # at zero, and driven down
    assert reward.dampened.sum() < -0.5


def test_pairs_follow_the_rule_ms_by_ms() -> None:
    draws = np.array([(k * k * 7919 + k * 104729) % 97 for k in range(600)]).reshape(2, 300)
    fired = draws < 9
    fired[:, 120] = True  # both in one ms
    pre, post = (np.flatnonzero(row) for row in fired)
    start, now = 100, 299
    last, eligibility = [NEVER, NEVER], 0.0
    for t in range(now + 1):
        eligibility *= math.exp(-1.0 / RULE.tau_eligibility)
        last = [t if fired[side, t] else last[side] for side in (0, 1)]
        if t < start:
            continue
        if fired[1, t]:
            eligibility += RULE.potentiation * math.exp((last[0] - t) / RULE.tau_plus)
        elif fired[0, t]:
            eligibility -= RULE.depression * math.exp((last[1] - t) / RULE.tau_minus)
    pairs = pairs_of(pre, post, RULE, start)
    assert pairs.decayed(RULE, now).sum() == pytest.approx(eligibility, rel=1e-12)
    assert (120, 120) in set(zip(pairs.pre.tolist(), pairs.post.tolist(), strict=True))
    alone = pairs_of(pre, np.zeros(0, np.int64), RULE)
    assert len(alone.value) == 0


@pytest.mark.parametrize(("simultaneous", "travel"), [("potentiates", 0), ("depresses", 0), ("depresses", 3)])
def test_pairs_make_the_eligibility_of_the_networks_own_step(simultaneous: str, travel: int) -> None:
    """Random trains of which many spikes fall into one ms, followed from the middle on."""
    steps, start = 240, 90
    groups = [make_group("pre", 4), make_group("post", 3), make_group("dopaminergic", 1)]
    weight = torch.full((1, 4, 3), 2.0, dtype=torch.float64)
    rule = replace(RULE, simultaneous=simultaneous, travel=travel)
    synapses = make_projection("all", "pre", "post", weight, rule=rule)
    network = make_network(groups, [synapses], make_dopamine(), gain=0.0)
    drawn = torch.rand(steps, 1, network.size, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
    current = SURE * (drawn < 0.3)
    current[:, :, -1] = 0.0
    first, _ = run_each("reference", network, current[:start])
    ledger = Ledger(copy.deepcopy(network))
    later, (eligibility,) = run_each("reference", network, current[start:], network.synapses.eligibility)
    fired = torch.cat([first, later])[:, 0]
    assert (fired[:, :4, None] & fired[:, None, 4:7]).sum(0).min() > 5
    ledger.follow(later, 1.0, "none", network.synapses.weight)
    time, neuron = later[:, 0].nonzero().numpy().T
    credit = Credit(ledger, start + time, neuron)
    assert np.abs(credit.carried).max() > 0.01
    for k in range(steps - start):
        parts = [credit.eligibility(synapse, start + k) for synapse in range(12)]
        total = [decayed.sum() + rest for decayed, rest in parts]
        np.testing.assert_allclose(total, eligibility[k], rtol=0, atol=1e-12)


def test_the_command_leaves_what_it_promises(replayed: Path) -> None:
    assert sorted(path.name for path in replayed.iterdir() if path.suffix != ".mp4") == [
        *("credit.csv", "credit.png", "credit.svg", "raster.png", "raster.svg", "replay.gif"),
        *(*("replay.nwb" for _ in NWB), "spikes.npz"),
    ]
    with Image.open(replayed / "replay.gif") as film:
        assert film.n_frames == 13  # type: ignore[attr-defined]
        assert film.info["duration"] == 70
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(12)
        assert np.abs(np.asarray(film.convert("RGB")) - first).max() > 100
    rows = list(csv.DictReader((replayed / "credit.csv").open()))
    food = [row for row in rows if row["cause"] == "food"]
    changes = [abs(float(row["weight_after"]) - float(row["weight_before"])) for row in food]
    assert changes == sorted(changes, reverse=True)
    assert changes[0] > 0.1
    for row in food[:50]:
        listed = sum(float(pair.partition(":")[2]) for pair in row["pairs"].split())
        assert listed + float(row["older"]) == pytest.approx(float(row["eligibility"]), abs=5e-4)


def test_its_figures_keep_the_convention(recording: Recording) -> None:
    explained = draw_credit(recording)
    assert explained is not None
    assert faults(draw_raster(recording)) == faults(explained) == []


def test_a_film_where_there_is_ffmpeg(replayed: Path) -> None:
    if shutil.which("ffmpeg") is None:
        pytest.skip("ffmpeg is not installed")
    assert b"ftyp" in (replayed / "replay.mp4").read_bytes()[:16]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--trial", "23"], "--trial=23: the run has trials 21 to 22"),
        (["--trial", "22", "--from", "5.6"], "--from=5.6: must be at least 0 and less than the run's 5.6 s"),
        (["--trial", "22", "--from", "nan"], "--from=nan: must be at least 0 and less than the run's 5.6 s"),
        (
            ["--trial", "22", "--from", "3", "--to", "2"],
            "--to=2.0: must be more than --from=3 and at most the run's 5.6 s",
        ),
    ],
)
def test_what_is_not_in_the_run_is_refused(
    run: Run, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        replay.main([str(run.folder), *arguments])
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"snnrl.replay: {message}\n"


def test_a_folder_without_a_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        replay.main([str(tmp_path), "--trial", "0"])
    assert ended.value.code == 2
    assert "no run folder" in capsys.readouterr().err


def test_a_replay_that_is_not_the_run_is_refused(run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("config.yaml", "series.npz"):
        shutil.copy(run.folder / name, tmp_path)
    text = (tmp_path / "config.yaml").read_text()
    (tmp_path / "config.yaml").write_text(text.replace("exploration: 2.35", "exploration: 3.5"))
    with pytest.raises(SystemExit) as ended:
        replay.main([str(tmp_path), "--trial", str(TRIAL), "--from", "5"])
    assert ended.value.code == 2
    assert "the replay is not the run" in capsys.readouterr().err
    assert not (tmp_path / "replay").exists()


@pytest.mark.parametrize("library", ["numpy", "neo", "elephant"])
def test_the_how_to_loads_what_was_written(
    library: str, run: Run, replayed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip(library, reason=f"{library} is not installed")
    blocks = re.findall(r"```py\n(.*?)```", HOW_TO, re.DOTALL)
    own = next(block for block in blocks if f"import {library}" in block)
    monkeypatch.chdir(replayed)
    names: dict[str, object] = {}
    needed = [own] if library != "elephant" else [blocks[blocks.index(own) - 1], own]
    for block in needed:
        exec(block, names)
    assert capsys.readouterr().out
    spikes = np.load("spikes.npz")
    if library == "numpy":
        series = names["series"]
        assert isinstance(series, np.lib.npyio.NpzFile)
        assert series["time"].shape == run.time.shape
    else:
        trains = names["trains"]
        assert isinstance(trains, list)
        assert len(trains) == spikes["size"].sum()
        assert sum(len(train) for train in trains) == len(spikes["time"])


def test_it_is_written_for_other_laboratories(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pynwb = pytest.importorskip("pynwb", reason="pynwb is not installed")
    path = tmp_path / "replay.nwb"
    write_nwb(recording, path, "a trial", datetime(2012, 6, 1, tzinfo=UTC))
    assert not pynwb.validate(path=str(path))
    monkeypatch.chdir(path.parent)
    exec(next(block for block in re.findall(r"```py\n(.*?)```", HOW_TO, re.DOTALL) if "pynwb" in block), {})
    counted = capsys.readouterr().out
    for group in recording.simulation.network.groups:
        assert group in counted
    with pynwb.NWBHDF5IO(path, "r") as file:
        read = file.read()
        units = read.units.to_dataframe()
        groups = recording.simulation.network.groups
        assert units["group"].value_counts(sort=False).to_dict() == {name: g.size for name, g in groups.items()}
        spikes = [(round(1000 * s), k) for k, train in enumerate(units["spike_times"]) for s in train]
        assert sorted(spikes) == sorted(zip(recording.time.tolist(), recording.neuron.tolist(), strict=True))
        behaviour = read.processing["behavior"]
        position = behaviour["Position"]["position"]
        scenes = np.array([scene["position"][0].tolist() for scene in recording.scenes])
        np.testing.assert_array_equal(position.data, scenes)
        assert (position.unit, position.starting_time) == ("meters", recording.start / 1000)
        assert position.rate == pytest.approx(1000 / 70)
        heading = behaviour["CompassDirection"]["heading"].data
        assert heading[-1] == recording.scenes[-1]["heading"][0]
        assert behaviour["touches_food"].data[:].tolist() == recording.touches["food"].tolist()
        np.testing.assert_array_equal(read.acquisition["dopamine"].data, recording.levels)
        rewards = read.intervals["rewards"].to_dataframe()
        assert rewards["cause"].tolist() == [reward.cause for reward in recording.credit.rewards]
        assert rewards["start_time"].tolist() == [reward.start / 1000 for reward in recording.credit.rewards]
