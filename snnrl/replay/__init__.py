"""One trial again with everything recorded: scenes of it, and what each reward did to which synapse.

Here belongs what looks into a single trial, ms by ms, long after its run.
"""
