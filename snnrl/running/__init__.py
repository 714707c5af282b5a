"""Runs in their folders: a job and its progress, checkpoints, merging; how a command starts and fails."""
