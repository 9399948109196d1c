"""What rig.toml states beyond the thesis's model (section 8.3): a stated truth removes the bias of an unstated one."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import pytest

from calibration.rig import Rig, load_rig, parse_rig
from tcdyn.partition.analyse import Partition
from tcdyn.pipeline.beta import prepare
from tests.partition.study_rigs import StudyRig, study_rig

SEED = 7000
FLUX = {"flux_profile": "barus", "flux_shift_mm": 0.4}


def stating(**tables: Any) -> Rig:
    """The default rig with these tables."""
    return parse_rig(tables, "rig.toml")


def seen_by(made: StudyRig, rig: Rig) -> Partition:
    """The log of ``made`` analysed by somebody who states ``rig``."""
    records = {d: r.model_copy(update={"setup": rig.tables(d)}) for d, r in made.records.items()}
    return replace(made, test=prepare(made.log, rig, records)).analyse()


@lru_cache
def usual() -> Partition:
    """The same rig and test as the thesis has them."""
    return study_rig(SEED).analyse()


def test_a_stated_flux_is_as_good_as_the_usual_one() -> None:
    """Heat with the oil's viscosity, 0.4 mm beside the centre, by sums over the ellipse."""
    rig = stating(contact=FLUX)
    made = study_rig(SEED, rig=rig)
    told, ignored = seen_by(made, rig), seen_by(made, load_rig())
    off = [max(abs(p.ways[w].value - usual().ways[w].value) for w in p.ways) for p in (told, ignored)]
    assert off[0] < 0.002  # the noise is the same, and so are the errors of the rig
    assert off[1] > 0.01
    assert told.status == "sound"
    named = ignored.structures.named
    assert named is not None
    assert named.name == "flux_shift"


def test_an_uncertain_place_of_the_flux_widens_and_is_in_the_budget() -> None:
    made = study_rig(SEED, rig=stating(contact=FLUX))
    rig = stating(contact={"flux_profile": "barus"}, uncertainty={"flux_shift_mm": 0.4})
    p = seen_by(made, rig)
    row = next(r for r in p.budget.rows if r.source == "place of the flux")
    assert row.u_beta_steady > 0.002
    both = p.both.estimates["beta"]
    assert both.u > 1.2 * usual().both.estimates["beta"].u
    assert abs(both.value - made.told["beta"]) < 2 * both.u
    assert "place of the flux" not in [r.source for r in usual().budget.rows]
    assert p.structures.named is None  # what is stated to be uncertain is no other structure


@pytest.mark.parametrize(
    ("contact", "words"),
    [
        ({"flux_profile": "sharp"}, "Input should be 'hertz', 'flat', 'barus' or 'table'"),
        ({"flux_profile": "table"}, "expected flux_table_mm and flux_table_weight of two places"),
        ({"flux_table_mm": [0.0, 1.0], "flux_table_weight": [1.0]}, "has 2 places, flux_table_weight 1"),
        ({"flux_table_mm": [1.0, 0.0], "flux_table_weight": [1.0, 1.0]}, "flux_table_mm must rise"),
    ],
)
def test_a_flux_that_cannot_be_is_refused(contact: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        stating(contact=contact)
