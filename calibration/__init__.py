"""Calibration of an instrumented disk: static lines, transducers, budget, comparison of records."""
