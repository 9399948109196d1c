"""The rim that most tests use."""

import pytest

from tcdyn.heat.rim import Rim, junction_points
from tcdyn.rig.rigfile import load_rig


@pytest.fixture(scope="session")
def setup():
    return load_rig().disk_setup("fast")


@pytest.fixture(scope="session")
def rim(setup):
    return Rim.from_setup(setup)


@pytest.fixture(scope="session")
def points(setup):
    return junction_points(setup, "ace")
