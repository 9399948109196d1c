"""The analysed test that the pages of one test are drawn from, made once."""

from __future__ import annotations

import pytest

from tcdyn.partition.analyse import Partition
from tcdyn.pipeline import estimate_beta
from tests.conftest import Campaign


@pytest.fixture(scope="session")
def partition(campaign: Campaign) -> Partition:
    """Test B3 of the shared campaign."""
    return estimate_beta(campaign.files.ehl["B3"], campaign.rig, campaign.records).partition
