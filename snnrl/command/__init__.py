"""The command `snnrl`: what it can do, its help and completion, and what only it does.

Here belongs what a user types and reads. What a command does is in the room that it belongs to.
"""
