"""What is wrong with how the axes of a figure are labelled."""

from __future__ import annotations

import re

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from snnrl.drawing.style import AREAS
from snnrl.thesis import fit

QUANTITY = r"[A-Z][^()_]* \([^()_]+(\([^()_]+\))?\)"
NUMBERS = {"Neuron", "Presynaptic neurons", "Postsynaptic neurons", "Swap", "Trials", "Point of the study"}  # counted
FACTORS = {"Sensor value", "Coding range gain", "Coding touch gain", "Network synaptic gain", "Gain of exploration"}
CHOICES = {fit.quantity(fit.short_name(key), "") for key, free in fit.FREE.items() if isinstance(free, fit.Choice)}
UNITLESS = {"Turn", "Plastic synapses of a trial", *NUMBERS, *FACTORS, *CHOICES}


def faults(drawn: Figure) -> list[str]:
    """Labels that are no quantity with a unit, axes without one, names as in code, areas that no legend explains."""
    shown = [axis for axis in drawn.axes if axis.axison]
    found = [
        text for axis in shown for text in (axis.get_xlabel(), axis.get_ylabel()) if text and not is_quantity(text)
    ]
    found += [
        f"{way} of {axis.get_title() or axis}" for axis in shown for way in "xy" if not has_label(axis, way, shown)
    ]
    texts = [text.get_text() for text in drawn.findobj(Text)]
    found += [text for text in texts if "_" in text or "uM" in text]
    areas = {str(collection.get_label()) for axis in shown for collection in axis.collections} & set(AREAS)
    return found + [area for area in areas if area not in texts]


def is_quantity(label: str) -> bool:
    """Whether it has the form Words (unit), perhaps below what it is of, or is of a number without a unit."""
    return label in UNITLESS or re.fullmatch(QUANTITY, label.replace("\n", " ")) is not None


def has_label(axis: Axes, way: str, shown: list[Axes]) -> bool:
    """Itself, by the names at its ticks, or by another one in its row or column."""
    if is_named(axis, way):
        return True
    place, span = axis.get_subplotspec(), "colspan" if way == "x" else "rowspan"
    if place is None:
        return axis.get_label() == "<colorbar>"
    others = [other.get_subplotspec() for other in shown if is_named(other, way)]
    return any(other is not None and getattr(other, span) == getattr(place, span) for other in others)


def is_named(axis: Axes, way: str) -> bool:
    of = getattr(axis, f"{way}axis")
    return bool(of.get_label_text()) or any(re.search("[a-z]", text.get_text()) for text in of.get_ticklabels())
