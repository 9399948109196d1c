"""Test design: what a planned test will be able to tell, by Fisher information, before it is run."""
