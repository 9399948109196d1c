"""Calibration of an instrumented disk: static lines, transducers, uncertainty of a reading, comparison of records."""
