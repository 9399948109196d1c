"""Heat partition: steady lines, cooling fit, joint fit, sensor check, and their cross-check.

Start at :mod:`tcdyn.partition.analyse`, which runs all stages of a test. The equations are in
docs/theory/partition.md.
"""
