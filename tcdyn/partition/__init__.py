"""Heat partition: steady lines, cooling fit, joint fit, sensor check, and their cross-check."""
