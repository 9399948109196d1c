"""The answers of one test as tables, and as ``beta.json`` keeps them."""

from tcdyn.pipeline.tables.answers import (
    NOTHING,
    SCHEMA,
    beta_file,
    budget_table,
    cooling_by_window,
    interval_table,
    junctions,
    junctions_table,
    referee_table,
    structures_table,
    test_table,
    u_of_beta,
    way_row,
    ways_table,
)
from tcdyn.pipeline.tables.both import both_budget, met, residuals_table

__all__ = [
    "NOTHING",
    "SCHEMA",
    "beta_file",
    "both_budget",
    "budget_table",
    "cooling_by_window",
    "interval_table",
    "junctions",
    "junctions_table",
    "met",
    "referee_table",
    "residuals_table",
    "structures_table",
    "test_table",
    "u_of_beta",
    "way_row",
    "ways_table",
]
