"""Many EHL logs to one table and one answer."""

from tcdyn.pipeline.campaign.run import CampaignSettings, run_campaign

__all__ = ["CampaignSettings", "run_campaign"]
