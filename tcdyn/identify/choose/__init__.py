"""Which model: those that are named, or those on the way of a search that grows, compared on one record."""

from tcdyn.identify.choose.comparison import CANDIDATES, Comparison, compare, joint_table
from tcdyn.identify.choose.held_out import held_out_score

__all__ = ["CANDIDATES", "Comparison", "compare", "held_out_score", "joint_table"]
