"""Thermocouples outside the rig: their file, and the ways to their lag (stated, plunge, pair, loop current, noise)."""

from tcdyn.sensor.file import SensorFile, from_identified, read_sensor, sensor_file, stated, step_times, write_sensor
from tcdyn.sensor.units import Unit

__all__ = [
    "SensorFile",
    "Unit",
    "from_identified",
    "read_sensor",
    "sensor_file",
    "stated",
    "step_times",
    "write_sensor",
]
