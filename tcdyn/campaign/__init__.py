"""Joint posterior of all tests of one rig.

Shared quantities of the rig are estimated once, so differences between tests and trends are much
better known than levels. Order of the work: ``compress`` makes the sufficient statistics of a test,
``posterior`` solves all tests, ``outliers`` removes tests that disagree, and ``exponent``,
``trends`` and ``result`` evaluate the posterior. ``stages`` splits a log into tests, ``planned``
predicts a campaign, ``interchange`` compares the temperature maps of two tests. Of tests analysed
one by one, ``stored_results`` reads the files and ``summary_table`` is the table with its trend
lines. The tests are in ``tests/campaign``.
"""

from tcdyn.campaign.compress import compress_likelihood, sufficient_statistics_of
from tcdyn.campaign.interchange import MapComparison, compare_maps
from tcdyn.campaign.posterior import Posterior, solve_campaign
from tcdyn.campaign.result import JoinedCampaign, join_results
from tcdyn.campaign.sufficient_statistics import (
    SufficientStatistics,
    rig_fingerprint,
    verify_checksum,
)

__all__ = [
    "JoinedCampaign",
    "MapComparison",
    "Posterior",
    "SufficientStatistics",
    "compare_maps",
    "compress_likelihood",
    "join_results",
    "rig_fingerprint",
    "solve_campaign",
    "sufficient_statistics_of",
    "verify_checksum",
]
