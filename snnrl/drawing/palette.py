"""All colours of figures, safe for the colour-blind. A robot has one colour everywhere."""

from __future__ import annotations

from collections.abc import Mapping

OTHER, PALE, INK = "#555555", "#bbbbbb", "#332288"
ROBOTS: Mapping[str, str] = {
    # after Okabe and Ito
    "random_walk": "#7f7f7f",
    "learning_disabled": "#000000",
    "learning": "#0072B2",
    "spiking": "#0072B2",
    "no_container_dopamine": "#E69F00",
    "container_dopamine_learning": "#009E73",
    "fixed_container_dopamine": "#D55E00",
    "benchmark": "#CC79A7",
    "positive_baseline": "#56B4E9",
    "no_burst_threshold": "#8C6D1F",
    "no_hunger": "#B8A200",
    "no_expectation": "#AA3377",
    # networks by what they expect
    "predicting": "#0072B2",
    "without inhibition": "#AA3377",
    "thesis's network": "#7f7f7f",
    # what another experiment leaves out, in the colour of what is alike
    "no_pain": "#B8A200",
    "hunger_hurts": "#997700",
    "no_moving_dopamine": "#E69F00",
    "fixed_dopamine": "#D55E00",
    # what is done inside the network, one thing at a time, and without what does it
    "phasic": "#009E73",
    "no_rhythm": "#56B4E9",
    "winner": "#D55E00",
    "no_rivalry": "#E69F00",
    "background": "#CC79A7",
    "in_network": "#332288",
    # without neurons
    "braitenberg": "#BBCC33",
    "q_learning": "#EE3377",
    "sarsa_lambda": "#661100",
    "reinforce": "#6699CC",
    "reinforce, many worlds": "#004488",
    "PPO, one life": "#DDAA33",
    "PPO, many worlds": "#44BB99",
}
CYCLE = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#8C6D1F", "#000000")  # of what is unnamed
ATTRACTION, AVOIDANCE = "#117733", "#AA4499"  # Tol's, apart from every robot's
FOOD, POISON, CONTAINER, EDGE = "#44AA99", "#882255", "#DDCC77", "#999933"
DOPAMINE, REWARDED, PUBLISHED = "#EE7733", "#C0392B", "#333333"
LEFT, RIGHT = INK, "#CC6677"  # of the robot
GROUPS = (INK, "#117733", "#882255", "#0077AA")  # of neurons, in turn
CREDIT = ("#009E73", "#E69F00", "#CC79A7", "#0072B2", "#999999", "#333333")  # what has changed a weight, in turn
NO_SYNAPSE, NO_FOOD = "#f7e6d0", "#f3e3c3"


def of_robot(name: str) -> str:
    return ROBOTS.get(name, OTHER)
