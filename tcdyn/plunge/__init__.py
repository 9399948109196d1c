"""The chain of every channel of a disk from its plunges, with everything that the plunge leaves open."""
