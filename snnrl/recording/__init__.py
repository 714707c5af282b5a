"""What is kept of a run: probes and their series, TensorBoard events, alarms, when a trial has learnt; and read back.

Here belongs what looks at a simulation and changes nothing in it.
"""
