"""The version, at the bottom of the house, so that nothing has to look up to it."""

__version__ = "0.2.0"
