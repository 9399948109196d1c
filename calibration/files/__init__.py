"""Any file of a logger to named columns."""
