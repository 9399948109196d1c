"""No damaged file ends in a traceback, a half-written output, or a wrong number without a flag."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tcdyn.core.errors import InputError
from tcdyn.rig.log import read_log
from tests.io.damaged_corpus import CORPUS, FLAGGED, REFUSED
from tests.rig.log_cases import FRAMES


def test_the_corpus_holds_at_least_sixty_files():
    assert len(CORPUS) >= 60
    assert len({d.name for d in CORPUS}) == len(CORPUS)


@pytest.mark.e2e
@pytest.mark.parametrize("damage", CORPUS, ids=[d.name for d in CORPUS])
def test_a_damaged_file_is_refused_or_flagged_in_one_sentence(tmp_path, damage):
    path = damage.build(tmp_path)
    if damage.fate == REFUSED:
        with pytest.raises(InputError, match=damage.words) as caught:
            read_log(path, damage.kind)
        assert "\n" not in str(caught.value)
        return
    log = read_log(path, damage.kind)
    assert damage.fate == FLAGGED
    assert any(re.search(damage.words, w) for w in log.warnings), log.warnings


@pytest.mark.parametrize(
    "name",
    ["spikes", "a huge value", "an infinite value", "one value missing", "five samples lost"],
)
def test_what_is_kept_is_either_the_truth_or_nan(tmp_path, name):
    damage = next(d for d in CORPUS if d.name == name)
    log = read_log(damage.build(tmp_path), damage.kind)
    true = FRAMES[damage.kind]()
    assert len(log.frame) == len(true)
    for column in true:
        kept = log.frame[column].to_numpy()
        wrong = np.isfinite(kept) & (
            np.abs(kept - true[column].to_numpy()) > 1e-9
        )  # inserted times are interpolated
        assert not wrong.any(), column
    assert log.frame.isna().to_numpy().sum() <= 5 * len(true.columns)


@pytest.mark.e2e
@pytest.mark.parametrize("kind", ["ehl", "immersion", "oven", "hole"])
def test_sound_logs_are_not_accused(tmp_path, kind):
    for seed in range(5):
        path = tmp_path / f"{seed}.csv"
        FRAMES[kind](seed=seed).to_csv(path, index=False)
        assert read_log(path, kind).warnings == ()
