"""The immersion test: fluids, natural convection, radial conduction, and the fit of chains to plunges."""
