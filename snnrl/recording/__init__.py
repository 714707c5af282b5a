"""What is kept of a run while it goes on: samples, TensorBoard events, alarms, and when a trial has learnt."""
