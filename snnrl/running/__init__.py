"""Runs in their folders: a job, its schedule and progress, checkpoints, merging; how a command starts and fails.

Here belongs what happens to a run from its command line to its end. The job alone advances time.
"""
