"""One trial again with everything recorded: scenes of it, and what each reward did to which synapse."""
