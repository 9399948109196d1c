"""Immersion test: fluids, natural convection, radial conduction, and the fit of measurement chains
to plunges.
"""
