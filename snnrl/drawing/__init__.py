"""How things look: style, arena, spikes, weights, tasks.

Here belongs what several others draw. It draws what it is given: it runs nothing, and reads no folder.
"""
