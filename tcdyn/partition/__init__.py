"""Heat partition: the steady lines, the cooling fit, the joint fit and their cross-check."""
