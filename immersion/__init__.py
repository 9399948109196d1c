"""Immersion test: fluids, natural convection, radial conduction, fit of chains to plunges.

The modules, from input to result: ``entry`` and ``plunge_data`` prepare a log; ``fluids`` and
``correlations`` give h; ``cylinder`` and ``radial`` solve conduction; ``plunge_parameters``,
``plunge_model`` and ``plunge_posterior`` are the model and its posterior; ``plunge_fit`` is the
entry point (:func:`immersion.plunge_fit.identify_plunges`), ``plunge_result`` its result, and
``plunge_checks`` compares plunges with each other.
``chain_structures`` compares forms of the chain; ``hole`` compares cemented and clamped
thermocouples. The tests are in ``tests/immersion``.
"""
