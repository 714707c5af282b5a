"""What a network without a body is asked to do: stimuli, watched synapses, rewards from outside.

Here belongs what drives a network, or looks at its spikes, without a world. It knows the network alone.
"""
