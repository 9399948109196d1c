"""Test design: what a planned test determines, by Fisher information, before it is run."""
