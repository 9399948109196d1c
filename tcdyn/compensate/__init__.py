"""From what the logger wrote back to what the junction felt, with an uncertainty for every sample."""

from tcdyn.compensate.profile import Burst, Intensity
from tcdyn.compensate.result import Compensated
from tcdyn.compensate.smoother import smooth

__all__ = ["Burst", "Compensated", "Intensity", "smooth"]
