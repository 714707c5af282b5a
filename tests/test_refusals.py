"""What is wrong with a command line or a file is said in one line; what is right is not refused."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import fuzz
import pytest
from helpers import compose_config
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from snnrl.configuration.builder import build
from snnrl.configuration.compose import conf_dir, dump, load, plain
from snnrl.configuration.refusals import misfit
from snnrl.errors import ConfigError
from snnrl.schema import Config, GroupConfig, ProjectionConfig, check_bounds

KEYS = "experiment, robot, network, coding, world, task, record, checkpoint, trials, trial_start, seconds, seed"
GRAMMAR = "must be KEY=VALUE, +KEY=VALUE or ~KEY, with all brackets and quotes closed"
OWN = "# @package _global_\nexperiment: {name: own, robots: [learning]}\ntrials: 1\n"


def composed(*overrides: str) -> Config:
    return compose_config("+experiment=food_attraction", "trials=1", *overrides)


@pytest.mark.parametrize("plus", ["+", "++"])
def test_a_projection_and_its_group_are_added_from_the_command_line(plus: str) -> None:
    config = composed(
        plus + "network.groups.extra={size: 3, neuron: excitatory}",
        plus + "network.projections.whole={pre: left_food, post: extra, synapse: taxis}",
        plus + "network.projections.parts.pre=extra",
        plus + "network.projections.parts.post=left_motor",
        plus + "network.projections.parts.synapse=reward",
    )
    assert config.network.groups["extra"] == GroupConfig(3, "excitatory")
    assert config.network.projections["whole"] == ProjectionConfig("left_food", "extra", "taxis")
    assert config.network.projections["parts"] == ProjectionConfig("extra", "left_motor", "reward")
    assert build(config).network.projections["whole"].shape == (1, 20, 3)


def test_what_is_there_is_changed_by_a_table_too() -> None:
    config = composed("network.groups.left_food={size: 21}", "+network.groups.right_food={noise: 0.5}")
    assert config.network.groups["left_food"] == GroupConfig(21, "excitatory")
    assert config.network.groups["right_food"] == GroupConfig(20, "excitatory", noise=0.5)


@pytest.mark.parametrize(
    ("override", "line"),
    [
        (
            "network.projections.x={pre: left_food, post: left_motor, synapse: taxis}",
            "network.projections.x: is not there; to add it write "
            "+network.projections.x={pre: left_food, post: left_motor, synapse: taxis}",
        ),
        ("network.groups=3", "network.groups=3: must be a table {NAME: ...}, each of which must hold size, neuron,"),
        ("+network.projections.x={pre: 1}", "network.projections.x.post=???: a value must be given"),
        (
            "+network.projections.x={pre: a, odd: b}",
            "network.projections.x.odd=b: no such key; allowed here: pre, post",
        ),
        ("+network.projections.x={pre: [a]}", "network.projections.x.pre=['a']: must be a name"),
        ("+network.projections.x=3", "network.projections.x=3: must hold pre, post, synapse, role"),
        ("+network.projections.x=null", "network.projections.x=None: must hold pre, post, synapse, role"),
        ("+network.projections.x.y.z=3", "network.projections.x.y={'z': 3}: no such key; allowed here: pre, post"),
        ("+network.projections={1: {pre: a}}", "network.projections=1: cannot be a name; in quotes it can"),
        (
            "network.groups.left_food=3",
            "network.groups.left_food=3: must hold size, neuron, current, noise, gaussian, kick, kick_rate",
        ),
        ("world.ranges={food: 3}", "world.ranges.food=3: must hold reach, measured_to"),
        ("robot.weights=[1]", "robot.weights=[1]: must be a table {NAME: ...}, each of which must be a number"),
        ("robot.fixed=3", "robot.fixed=3: must be a list [...]"),
        ("network.homeostasis=3", "network.homeostasis=3: must hold sets, limit, step, count_absent, per_set, or null"),
        ("seed=1.5", "seed=1.5: must be a whole number"),
        ("seconds=long", "seconds=long: must be a number"),
        ("network.synapses.taxis.plastic=maybe", "network.synapses.taxis.plastic=maybe: must be true or false"),
        ("device=null", "device=None: must be a name"),
        ("trials.a=3", "trials={'a': 3}: must be a whole number"),
        ("seconds=${trials.a}", "seconds=${trials.a}: ConfigTypeError raised while resolving interpolation"),
        ("foo=bar", f"foo=bar: no such key; allowed here: {KEYS}"),
        ("+foo=bar", f"foo=bar: no such key; allowed here: {KEYS}"),
        ("nogroup/x=y", f"nogroup/x=y: no such key; allowed here: {KEYS}"),
        ("world=nothing", "world=nothing: must be one of chain, food_container, food_only, food_poison"),
        ("hydra/launcher=nothing", "hydra/launcher=nothing: must be one of basic"),
        (
            "network=3",
            "network=3: must be one of avoidance, chain, food_container, food_only, food_poison, food_taxis_given, "
            "in_network, izhikevich_2007, obstacles, predicting; ~network leaves it out",
        ),
        ("robot=null", "robot=None: must be one of background, benchmark"),
        ("+world=food_only", "world: is chosen already; to choose another write world=NAME"),
        ("+trials=3", "+trials: is there already, write trials=VALUE"),
        ("~nothing", "~nothing: there is no such key"),
        ("~robot=odd", "~robot=odd: is not chosen"),
        ("~robot=3", "~robot=3: must be ~robot"),
        ("~network.dopamine.tau", "~network.dopamine.tau: cannot be left out"),
        ("hydra.mode=odd", "hydra.mode: Invalid value 'odd', expected one of [RUN, MULTIRUN]"),
        ("hydra.odd=3", "hydra.odd=3: no such key; allowed here: defaults, mode, searchpath"),
        ("trials", f"trials: {GRAMMAR}"),
        ("trials==3", f"trials==3: {GRAMMAR}"),
        ("=3", f"=3: {GRAMMAR}"),
        ("", f"'': {GRAMMAR}"),
        ("world.ranges.food={reach: 30", f"world.ranges.food={{reach: 30: {GRAMMAR}"),
        ("trials=odd(1)", "trials=odd(1): HydraException while evaluating 'odd(1)': Unknown function 'odd'"),
        ("trials=choice(1,2)", "trials=choice(1,2): needs -m (a sweep)"),
        ("hydra.searchpath=[odd://x]", "No config source registered for schema odd, supported types"),
    ],
)
def test_a_wrong_override_is_refused_in_one_line(override: str, line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(composed(override))
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


def test_an_override_that_fits_is_not_blamed_for_another() -> None:
    fitting = (
        "hydra/job_logging=none",
        "robot=random_walk",
        "world.kinds.food.poison_from=null",
        "network.homeostasis=null",
    )
    with pytest.raises(ConfigError, match=r"^trials=many: must be a whole number$"):
        composed(*fitting, "trials=many")


def test_an_experiment_needs_no_plus() -> None:
    assert compose_config("experiment=orbit", "seed=3") == compose_config("+experiment=orbit", "seed=3")
    with pytest.raises(ConfigError, match=r"^experiment=obrit: must be one of avoidance, "):
        compose_config("experiment=obrit")


FILES = [  # what an experiment's file has after its first lines, and what is said of it
    ("seconds: 1\n  more: 2\n", "{file}, line 5, column 7: mapping values are not allowed here"),
    ("seconds: [1\nseed: 2\n", "{file}, line 5, column 5: expected ',' or ']', but got ':'"),
    ("seconds: 1\nseconds: 2\n", "{file}, line 5, column 1: found duplicate key seconds"),
    ("seconds: *one\n", "{file}, line 4, column 10: found undefined alias 'one'"),
    ("seconds: \xff\n", "{name}: cannot be read ('utf-8' codec can't decode byte 0xff"),
    ("trails: 1\n", f"{{name}}: trails=1: no such key; allowed here: {KEYS}"),
    ("seconds: long\n", "{name}: seconds=long: must be a number"),
    ("world: {ranges: {food: 3}}\n", "{name}: world.ranges.food=3: must hold reach, measured_to"),
    ("network: {projections: {x: {pre: a, odd: b}}}\n", "{name}: network.projections.x.odd=b: no such key; allowed"),
    ("network: 3\n", "{name}: network=3: must hold neurons, synapses, groups"),
]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        *FILES,
        ("hydra: {odd: 3}\n", "{name}: hydra.odd=3: no such key; allowed here: defaults, mode"),
        ("defaults: 3\n", "{name}: cannot be read (Invalid defaults list in 'experiment/own'"),
        ("defaults: [{override /robot: odd}]\n", "robot=odd: must be one of background, benchmark"),
        ("defaults: [{/odd: own}]\n", "In 'experiment/own': Could not find 'odd/own'"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: str, line: str) -> None:
    file = tmp_path / "experiment" / "own.yaml"
    file.parent.mkdir()
    file.write_bytes((OWN + text).encode("latin-1"))
    with pytest.raises(ConfigError) as caught:
        compose_config(f"hydra.searchpath=[file://{tmp_path}]", "+experiment=own", "seconds=1")
    assert str(caught.value).startswith(line.format(file=file, name="experiment/own.yaml"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("text", "line"), [*FILES, ("a: &a [*a]\n", "{name}: cannot be read")])
def test_a_wrong_config_of_a_run_is_named(tmp_path: Path, text: str, line: str) -> None:
    file = tmp_path / "config.yaml"
    file.write_bytes((OWN + text).encode("latin-1"))
    with pytest.raises(ConfigError) as caught:
        load(file)
    assert str(caught.value).startswith(line.format(file=file, name=file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["- a\n", "a text\n", "3\n"])
def test_a_config_that_is_no_table_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"^{tmp_path}/config.yaml: ") as caught:
        load(tmp_path / "config.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", sorted(Path(conf_dir(), "experiment").glob("*.yaml")), ids=lambda path: path.stem)
def test_what_is_in_conf_fits(path: Path, tmp_path: Path) -> None:
    config = compose_config(f"+experiment={path.stem}")
    assert misfit(Config, asdict(config)) is None
    (tmp_path / "config.yaml").write_text(dump(config))
    assert load(tmp_path / "config.yaml") == config


def test_only_what_omegaconf_refuses_is_a_misfit() -> None:
    fitting = 0
    for seed in range(400):
        how, tree = fuzz.case(seed)
        try:
            merged = OmegaConf.merge(OmegaConf.structured(Config), tree)
            assert isinstance(merged, DictConfig)
            check_bounds(plain(merged))
        except (OmegaConfBaseException, OverflowError, ConfigError):
            continue
        fitting += 1
        assert misfit(Config, tree) is None, how
    assert fitting > 50
