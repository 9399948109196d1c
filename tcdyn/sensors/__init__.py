"""Thermocouples outside the rig: their file, and methods to determine their lag.

>>> import tempfile
>>> from pathlib import Path
>>> from tcdyn.chain import Chain
>>> from tcdyn.sensors import read_sensor, sensor_file, write_sensor
>>> probe = sensor_file("probe", {"T1": Chain(1.5)}, "stated", [[0.1**2]], [0.0])
>>> with tempfile.TemporaryDirectory() as folder:
...     again = read_sensor(write_sensor(probe, Path(folder) / "probe.sensor.json"))
>>> again.sensor, again.chain.channels["T1"].lag_s.value
('probe', 1.5)
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
from tcdyn.sensors.units import Unit

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
