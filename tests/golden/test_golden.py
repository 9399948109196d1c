"""The rebuilt house gives the answers that version 0.1 gave."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.conftest import Campaign
from tests.golden.answers import KEPT, answers

RELATIVE = 1e-6  # a fit ends where its search stops; 1e-6 is a thousandth of any stated uncertainty
PROFILES = 1e-6  # a profile is drawn at places that an iteration found


@pytest.fixture(scope="module")
def now(campaign: Campaign) -> dict[str, dict[str, float]]:
    return answers(campaign)


@pytest.mark.parametrize("group", ["record fast", "record slow", "beta.json", "compensated", "case A"])
def test_golden_answers_of_version_0_1_hold(group: str, now: dict[str, dict[str, float]]) -> None:
    kept = json.loads(KEPT.read_text(encoding="utf-8"))[group]
    assert len(kept) >= 16
    assert set(kept) <= set(now[group]), sorted(set(kept) - set(now[group]))[:5]
    names = list(kept)
    then, new = np.array([kept[n] for n in names]), np.array([now[group][n] for n in names])
    # covariances pass through zero; the z of two ways that agree is a small difference of large numbers
    floor = 1e-8 if group == "beta.json" else 1e-10
    relative = np.array([PROFILES if "/profiles/" in n else RELATIVE for n in names])
    off = np.abs(new - then) / (relative * np.abs(then) + floor)
    worst = int(np.argmax(off))
    assert off[worst] <= 1, f"{names[worst]}: {then[worst]:.12g} became {new[worst]:.12g}"
