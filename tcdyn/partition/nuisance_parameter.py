"""Name and budget line of a nuisance parameter; used by all fits of a test.

A nuisance parameter is a quantity that the fits need, that the test does not measure, and that has
a prior: a junction's depth, the conductivity, a static line, the angular harmonic. This module only
names it. Its standard uncertainty and its effect on the readings are computed in
:mod:`tcdyn.partition.nuisance`, :mod:`tcdyn.partition.specified` and
:mod:`tcdyn.partition.angular_harmonic`. Nuisance parameters serve as keys in the joint fits, in the
cross-check and in :mod:`tcdyn.campaign.compress`. ``tests/partition/test_as_logged.py`` and
``tests/partition/test_effects.py`` guard the names.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NuisanceParameter:
    """A quantity with a prior that the test does not measure (type B input quantity of the GUM).

    Parameters
    ----------
    name
        Its name, for example "depth a" or "conductivity". With ``shared`` it identifies the
        parameter.
    source
        Its line of the uncertainty budget. Parameters of one source are one line.
    shared
        Whether both disks have the parameter in common, with the same error. If not, each disk has
        its own, independent one.

    Notes
    -----
    The object holds no number. In the fits each parameter is in units of its standard uncertainty,
    so its prior is standard normal.

    What may change: ``source`` is only a label, but ``tcdyn.partition.crosscheck._nuisance_pulls``,
    ``tcdyn.partition.joint._pulls`` and ``tcdyn.partition.angular_harmonic.HARMONIC_SOURCES``
    compare it. ``name`` is compared in
    ``tcdyn.campaign.compress.loading_of``, ``tcdyn.partition.departures.DiskAtFit.lag_effects`` and
    ``tcdyn.partition.sensor_faults``; a channel is the last word of its name. The Monte Carlo
    samples of ``tcdyn.partition.crosscheck.monte_carlo`` are drawn in the order of the names, so a
    new name may change results by their sampling error. ``shared`` decides whether the disks'
    errors cancel.
    """

    name: str
    source: str
    shared: bool = False
