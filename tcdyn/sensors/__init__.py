"""Thermocouples outside the rig: their file, methods to determine their lag, and compensation.

``compensation`` smooths a table segment by segment, with the channels of ``channels``.
"""

from tcdyn.sensors.file import (
    SensorFile,
    from_identified,
    read_sensor,
    sensor_file,
    specified_sensor,
    step_times,
    write_sensor,
)
from tcdyn.sensors.measure import (
    sensor_from_current,
    sensor_from_dip,
    sensor_from_noise,
    sensor_from_pair,
)
from tcdyn.series.units import Unit

__all__ = [
    "SensorFile",
    "Unit",
    "from_identified",
    "read_sensor",
    "sensor_file",
    "sensor_from_current",
    "sensor_from_dip",
    "sensor_from_noise",
    "sensor_from_pair",
    "specified_sensor",
    "step_times",
    "write_sensor",
]
