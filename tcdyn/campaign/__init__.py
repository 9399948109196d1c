"""All tests of one rig as one measurement: what they share is solved for once, so that differences and trends are known
far better than levels (design, section 13)."""

from tcdyn.campaign.compress import compressed, kept_of
from tcdyn.campaign.posterior import Posterior, solve
from tcdyn.campaign.result import JoinedCampaign, joined
from tcdyn.campaign.sufficient_statistics import KeptTest, checked, rig_fingerprint

__all__ = [
    "JoinedCampaign",
    "KeptTest",
    "Posterior",
    "checked",
    "compressed",
    "joined",
    "kept_of",
    "rig_fingerprint",
    "solve",
]
