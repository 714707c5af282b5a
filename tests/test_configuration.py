"""Every file in conf/ composes and runs; bad values are refused in one line that names them."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers import compose_config

from snnrl.configuration.builder import build
from snnrl.configuration.compose import conf_dir
from snnrl.engines import make_engine
from snnrl.errors import ConfigError

EXPERIMENTS = sorted(path.stem for path in Path(conf_dir(), "experiment").glob("*.yaml"))
CASES = [
    (experiment, robot)
    for experiment in EXPERIMENTS
    for robot in compose_config(f"+experiment={experiment}").experiment.robots
]


@pytest.mark.parametrize(("experiment", "robot"), CASES)
def test_every_experiment_runs_with_each_of_its_robots(experiment: str, robot: str) -> None:
    config = compose_config(f"+experiment={experiment}", f"robot={robot}", "trials=2", "seconds=0.7")
    assert (config.experiment.name, config.robot.name) == (experiment, robot)
    engine = make_engine("fused", "cpu")
    run = build(config)
    run.run(engine, 10)
    assert int(run.network.time) == 10 * run.tick
    assert int(run.network.spike_count.sum()) > 0


def test_published_sizes_are_the_defaults() -> None:
    sizes = {name: compose_config(f"+experiment={name}") for name in EXPERIMENTS}
    assert (sizes["food_attraction"].trials, sizes["food_attraction"].seconds) == (50, 1000.0)
    assert (sizes["dual_learning"].trials, sizes["dual_learning"].seconds) == (50, 5000.0)
    assert sizes["dual_learning"].robot.name == "learning"


def test_robots_have_the_published_number_of_neurons() -> None:
    assert build(compose_config("+experiment=food_attraction", "trials=1")).network.size == 160
    assert build(compose_config("+experiment=dual_learning", "trials=1")).network.size == 240


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("network.synapses.taxis.probability=1.2", "network.synapses.taxis.probability=1.2: must be at least 0"),
        ("network.synapses.taxis.delay=0", "network.synapses.taxis.delay=0: must be at least 1"),
        ("network.synapses.taxis.weight=5", "network.synapses.taxis.weight=5 to 5: plastic weights are in"),
        ("network.dopamine.tau=-1", "network.dopamine.tau=-1.0: must be greater than 0"),
        ("network.plasticity.tau_plus=0", "network.plasticity.tau_plus=0.0: must be greater than 0"),
        ("network.dopamine.source=nobody", "network.dopamine.source=nobody: must be one of left_food"),
        ("network.projections.left_food_to_left_motor.pre=nobody", "left_motor.pre=nobody: must be one of left_food"),
        ("network.groups.left_food.neuron=odd", "groups.left_food.neuron=odd: must be one of excitatory"),
        ("network.groups.left_food.size=0", "network.groups.left_food.size=0: must be at least 1"),
        ("network.homeostasis.sets.food_taxis=[odd]", "sets.food_taxis=odd: must be one of food_attraction"),
        ("+network.homeostasis.sets.two=[reward,food_avoidance]", "already belongs to the set food_taxis"),
        ("trials=0", "trials=0: must be at least 1"),
        ("seconds=0", "seconds=0.0: must be greater than 0"),
        ("seconds=nan", "seconds=nan: must be a finite number"),
        ("seed=-1", "seed=-1: must be at least 0"),
        ("engine=fast", "engine=fast: must be one of auto, reference, fused"),
        ("dtype=float16", "dtype=float16: must be one of float32, float64"),
        ("device=cuda:99", "device=cuda:99: this machine has"),
        ("device=abacus", "device=abacus: must be cpu or cuda"),
        ("world.side=64", "world.side=64.0: must be at least 64.8"),
        ("world.ranges.food.measured_to=edge", "measured_to=edge: must be one of border, centre"),
        ("coding.slow=40", "coding.slow=40.0: must be at most coding.fast=31.2"),
        ("coding.motors.left=nobody", "coding.motors.left=nobody: must be one of left_food"),
        ("coding.ranges.food.left=inhibitory", "must be one of"),
        ("coding.ranges.food.left=food_touch", "coding.ranges.food.left=food_touch: must have a projection to a motor"),
        ("+coding.touches.smell=food_touch", "coding.touches=smell: must be one of food"),
        ("+robot.weights.food_attraction=4.5", "robot.weights.food_attraction=4.5: must be in [0, 4]"),
        ("+robot.weights.odd=1", "robot.weights=odd: must be one of food_attraction"),
        ("robot.fixed=[odd]", "robot.fixed=odd: must be one of food_attraction"),
        ("robot.name=benchmark", "robot=benchmark: must be one of learning, random_walk"),
        ("experiment.correct.food=half", "experiment.correct.food=half: must be one of together, each_side"),
        ("+experiment.correct.smell=together", "experiment.correct=smell: needs projections"),
    ],
)
def test_bad_values_are_refused_by_name(override: str, message: str) -> None:
    config = compose_config("+experiment=food_attraction", "trials=1", override)
    if "inhibitory" in override:
        config.network.projections = {
            name: p for name, p in config.network.projections.items() if p.pre != "inhibitory"
        }
        message = "coding.ranges.food.left=inhibitory: must have a projection to a motor group"
    with pytest.raises(ConfigError) as caught:
        build(config)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
