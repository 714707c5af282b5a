"""Colours of what is in a world, safe for the colour-blind; those of robots are in `snnrl.drawing.style`."""

ATTRACTION, AVOIDANCE, OTHER = "#117733", "#AA4499", "#555555"  # Tol's, apart from every robot's
FOOD, POISON, CONTAINER = "#44AA99", "#882255", "#DDCC77"
