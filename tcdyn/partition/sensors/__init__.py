"""Whether all junctions are where ``rig.toml`` says, wired as their columns say, and alive."""

from tcdyn.partition.sensors.check import SensorCheck, angle_groups, check_sensors, demand
from tcdyn.partition.sensors.rest import cables_exchanged

__all__ = ["SensorCheck", "angle_groups", "cables_exchanged", "check_sensors", "demand"]
