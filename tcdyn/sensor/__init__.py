"""Thermocouples outside the rig: their file, and the ways to their lag (stated, plunge, pair, loop current, noise).

>>> import tempfile
>>> from pathlib import Path
>>> from tcdyn.chain import Chain
>>> from tcdyn.sensor import read_sensor, sensor_file, write_sensor
>>> probe = sensor_file("probe", {"T1": Chain(1.5)}, "stated", [[0.1**2]], [0.0])
>>> with tempfile.TemporaryDirectory() as folder:
...     again = read_sensor(write_sensor(probe, Path(folder) / "probe.sensor.json"))
>>> again.sensor, again.chain.channels["T1"].lag_s.value
('probe', 1.5)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from tcdyn.sensor.units import Unit

if TYPE_CHECKING:
    from tcdyn.sensor.file import (
        SensorFile,
        from_identified,
        read_sensor,
        sensor_file,
        stated,
        step_times,
        write_sensor,
    )

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


def __getattr__(name: str) -> Any:
    """What is not ``Unit``, where it is asked for: a log of the rig has no use for the files of other sensors."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("tcdyn.sensor.file"), name)


def __dir__() -> list[str]:
    """The names of this room, asked for already or not."""
    return sorted(__all__)
