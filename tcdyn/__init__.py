"""Thermocouple dynamics and heat partition."""

__version__ = "0.1.0"
