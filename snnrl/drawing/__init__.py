"""How things look: style, arena, spikes, weights. Draws what it is given and runs nothing."""
