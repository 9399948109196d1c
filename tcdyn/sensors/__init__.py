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
from tcdyn.sensors.history import SensorHistory, sensor_history
from tcdyn.sensors.measure import (
    sensor_from_current,
    sensor_from_dip,
    sensor_from_noise,
    sensor_from_pair,
)
from tcdyn.sensors.predict import predict_sensor
from tcdyn.sensors.ratio import SensorComparison, compare_sensors
from tcdyn.series.units import Unit

__all__ = [
    "SensorComparison",
    "SensorFile",
    "SensorHistory",
    "Unit",
    "compare_sensors",
    "from_identified",
    "predict_sensor",
    "read_sensor",
    "sensor_file",
    "sensor_from_current",
    "sensor_from_dip",
    "sensor_from_noise",
    "sensor_from_pair",
    "sensor_history",
    "specified_sensor",
    "step_times",
    "write_sensor",
]
