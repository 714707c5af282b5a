"""What a network without a body is asked to do: stimuli, watched synapses, rewards from outside."""
