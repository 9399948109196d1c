"""Calibration of an instrumented disk: static lines, transducers, budget, comparison of records.

``static_lines`` fits the oven log, ``transducers`` the force transducers and the bearings,
``budget`` states the uncertainty of a channel at rest, ``compare`` compares and checks records, and
``decisions`` states whether a thermocouple is fit to use and when to calibrate it again.
Used by ``tcdyn.workflows``, ``tcdyn.report``, ``tcdyn.plots`` and ``tcdyn.cli``. Tests:
``tests/calibration``.
"""
