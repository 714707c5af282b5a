"""Every experiment at small size, bit for bit as recorded, on any machine: a change that is not meant to change
results changes none.

After a change that is meant to, run `python tests/test_goldens.py`, and say which and why in its commit.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch
from helpers import compose_config

from snnrl.running.job import perform

FILE = Path(__file__).parent / "goldens.json"
SMALL = ("trials=3", "record.tensorboard=false", "threads=1")
LONG = ("seconds=40", "record.every=4", *SMALL)
TASK = ("seconds=4", "record.every=1", *SMALL)
CASES: dict[str, tuple[str, ...]] = {
    "orbit/learning": ("seconds=10", *SMALL),
    "orbit/learning_disabled": ("seconds=10", *SMALL),
    "orbit/positive_baseline": ("seconds=10", *SMALL),
    "food_attraction/learning": LONG,
    "food_attraction/random_walk": LONG,
    "food_attraction/no_hunger": LONG,
    "food_poison/learning": (*LONG, "poison=20"),
    "secondary_stimulus/learning": LONG,
    "secondary_stimulus/no_burst_threshold": LONG,
    "secondary_behaviour/learning_disabled": LONG,
    "secondary_behaviour/no_container_dopamine": LONG,
    "secondary_behaviour/container_dopamine_learning": LONG,
    "secondary_behaviour/fixed_container_dopamine": LONG,
    "secondary_behaviour/benchmark": LONG,
    "dual_learning/learning": LONG,
    "stdp_search/learning": LONG,
    "changing_world/learning": (*LONG, "turns=12"),
    "chain/learning": LONG,
    "avoidance/learning": LONG,
    "in_network/in_network": LONG,
    "obstacles/learning": LONG,
    "extinction/learning": (*LONG, "absent=10"),
    "distal_reward/learning": TASK,
    "classical_conditioning/learning": TASK,
    "dual_learning/learning, reference": ("engine=reference", "seconds=4.2", "record.every=1.4", *SMALL),
    "food_poison/learning, reference": ("engine=reference", "seconds=2.8", "poison=1.4", "record.every=0.7", *SMALL),
    "distal_reward/learning, reference": ("engine=reference", "seconds=0.6", "record.every=0.2", *SMALL),
    "dual_learning/learning, float64": (*LONG, "dtype=float64"),
    "food_attraction/learning, float64": (*LONG, "dtype=float64"),
}
MOVED = {  # a case's words, and the keys that they stand for today
    "poison=": "world.kinds.food.poison_from=",
    "turns=": "world.kinds.food.turns_every=",
    "absent=": "world.kinds.food.absent_from=",
}


def digests(case: str, folder: Path) -> dict[str, str]:
    """What a run keeps, by file and name."""
    name, _, _ = case.partition(",")
    experiment, _, robot = name.partition("/")
    options = list(CASES[case])
    for word, key in MOVED.items():
        options = [option.replace(word, key) if option.startswith(word) else option for option in options]
    perform(compose_config(f"+experiment={experiment}", f"robot={robot}", *options), folder)
    kept = {"trials": hashlib.sha256((folder / "trials.csv").read_bytes()).hexdigest()[:16]}
    for file in ("series", "weights"):
        if (folder / f"{file}.npz").exists():
            with np.load(folder / f"{file}.npz") as arrays:
                for key in sorted(arrays.files):
                    values = np.ascontiguousarray(arrays[key])
                    content = f"{values.dtype} {values.shape}".encode() + values.tobytes()
                    kept[f"{file}/{key}"] = hashlib.sha256(content).hexdigest()[:16]
    return kept


@pytest.mark.parametrize("case", CASES)
def test_every_experiment_is_bit_for_bit_as_recorded(case: str, tmp_path: Path) -> None:
    assert digests(case, tmp_path) == json.loads(FILE.read_text())[case]


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    found = {}
    for case in CASES:
        with TemporaryDirectory() as folder:
            found[case] = digests(case, Path(folder))
        print(case, file=sys.stderr)
    FILE.write_text(json.dumps(found, indent=1) + "\n")
