"""All tests of one rig as one measurement: what they share is solved for once, so that differences
and trends are known far better than levels (design, section 13).
"""

from tcdyn.campaign.compress import compress_likelihood, sufficient_statistics_of
from tcdyn.campaign.posterior import Posterior, solve
from tcdyn.campaign.result import JoinedCampaign, joined
from tcdyn.campaign.sufficient_statistics import SufficientStatistics, checked, rig_fingerprint

__all__ = [
    "JoinedCampaign",
    "Posterior",
    "SufficientStatistics",
    "checked",
    "compress_likelihood",
    "joined",
    "rig_fingerprint",
    "solve",
    "sufficient_statistics_of",
]
