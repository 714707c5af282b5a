"""Numbers that a network's kernels are compiled for: loops of a known length cost no more than what is in them."""

from __future__ import annotations

from typing import Any, NamedTuple


class Shape(NamedTuple):
    """Of a network and of the blocks that it runs on."""

    lanes: int  # threads of a block
    neurons: int
    words: int  # whose bits say of each neuron whether it has fired
    groups: int
    runs: int  # of synapses that learn alike, see `Wiring`
    sets: int  # homeostatic ones
    modulators: int
    signals: int  # sums of modulators that synapses listen to
    phases: int  # of sending, see `Wiring`
    slots: int  # ms for which input may be pending


# what they are called in kernels; a `Program` says what each is
LANES: Any = None
NEURONS: Any = None
WORDS: Any = None
GROUPS: Any = None
RUNS: Any = None
SETS: Any = None
MODULATORS: Any = None
SIGNALS: Any = None
PHASES: Any = None
SLOTS: Any = None


def names_of(shape: Shape) -> dict[str, int]:
    """What those names stand for."""
    return {name.upper(): value for name, value in shape._asdict().items()}
