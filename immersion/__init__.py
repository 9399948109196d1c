"""Immersion test: fluids, natural convection, radial conduction, fit of chains to plunges."""
