"""The plunge test and its physics."""
