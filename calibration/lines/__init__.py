"""Straight lines of sensors: static lines, bearing friction, transducers; type J."""
