"""Fewer draws than users get, where a test does not look at the ranges."""

from __future__ import annotations

import pytest

FEW = 40


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models are tuned with few draws."""
    monkeypatch.setattr("tcdyn.identification.identified.N_DRAWS", FEW)
