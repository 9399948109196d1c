"""Calibration of an instrumented disk: static lines, transducers, budget, comparison of records.

``static_lines`` fits the oven log, ``transducers`` the force transducers and the bearings,
``budget`` states the uncertainty of a channel at rest, and ``compare`` compares and checks records.
Used by ``tcdyn.workflows``, ``tcdyn.report``, ``tcdyn.plots`` and ``tcdyn.cli``. Tests:
``tests/calibration``.
"""
