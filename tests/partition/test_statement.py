"""What rig.toml states beyond the thesis's model (section 8.3): a stated truth removes the bias of an unstated one."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tcdyn.core import Array
from tcdyn.partition.analyse import Partition
from tcdyn.partition.events import EhlTest
from tcdyn.partition.specified import (
    conductivity_slope_effect,
    linear_about,
    specific_heat_slope_effect,
)
from tcdyn.partition.steady import with_linear_steel
from tcdyn.partition.window import DiskWindow, fit_rows, lagged_window
from tcdyn.rig.rigfile import Rig, load_rig, parse_rig
from tcdyn.rig.tables import SurfaceFlux, fit_surface_flux
from tcdyn.simulate.truth import draw_truth
from tcdyn.workflows.beta import prepare_test
from tests.partition.study_rigs import StudyRig, study_rig

SEED = 7000
FLUX = {"flux_profile": "barus", "flux_shift_mm": 0.4}


def stating(**tables: Any) -> Rig:
    """The default rig with these tables."""
    return parse_rig(tables, "rig.toml")


def seen_by(made: StudyRig, rig: Rig) -> Partition:
    """The log of ``made`` analysed by somebody who states ``rig``."""
    return replace(made, test=seen_test(made, rig)).analyse()


def seen_test(made: StudyRig, rig: Rig) -> EhlTest:
    """The log of ``made`` prepared by somebody who states ``rig``."""
    records = {d: r.model_copy(update={"setup": rig.tables(d)}) for d, r in made.records.items()}
    return prepare_test(made.log, rig, records)


@lru_cache
def usual() -> Partition:
    """The same rig and test as the thesis has them."""
    return study_rig(SEED).analyse()


@pytest.mark.study
def test_a_stated_flux_is_as_good_as_the_usual_one() -> None:
    """Heat with the oil's viscosity, 0.4 mm beside the centre, by sums over the ellipse."""
    rig = stating(contact=FLUX)
    made = study_rig(SEED, rig=rig)
    told, ignored = seen_by(made, rig), seen_by(made, load_rig())
    off = [
        max(
            abs(p.beta_by_estimator[w].value - usual().beta_by_estimator[w].value)
            for w in p.beta_by_estimator
        )
        for p in (told, ignored)
    ]
    assert off[0] < 0.002  # the noise is the same, and so are the errors of the rig
    assert off[1] > 0.01
    assert told.status == "sound"
    named = ignored.model_forms.preferred
    assert named is not None
    assert named.name == "flux_shift"


@pytest.mark.study
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
    assert p.model_forms.preferred is None  # what is stated to be uncertain is no other structure


TABLE = {"flux_profile": "table"}


@pytest.mark.parametrize(
    ("contact", "words"),
    [
        ({"flux_profile": "sharp"}, "Input should be 'hertz', 'flat', 'barus' or 'table'"),
        (TABLE, "flux_table_mm has 0 places; expected two or more"),
        (
            {**TABLE, "flux_table_mm": [0.0, 1.0], "flux_table_weight": [1.0]},
            "has 2 places, flux_table_weight 1",
        ),
        (
            {**TABLE, "flux_table_mm": [1.0, 0.0], "flux_table_weight": [1.0, 1.0]},
            "flux_table_mm must rise",
        ),
    ],
)
def test_a_flux_that_cannot_be_is_refused(contact: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        stating(contact=contact)


STEEL = {"conductivity_slope_per_K": -7e-4, "specific_heat_slope_per_K": 6e-4}


@pytest.mark.study
def test_a_stated_slope_of_the_steel_removes_its_bias_and_an_open_one_widens() -> None:
    """Conduction with k(T) and c(T) solved for the whole disk; the noise and all other errors are the usual rig's."""
    rig = stating(disk=STEEL)
    made = study_rig(SEED, rig=rig)
    told, ignored = seen_by(made, rig), seen_by(made, load_rig())
    off = [
        max(
            abs(p.beta_by_estimator[w].value - usual().beta_by_estimator[w].value)
            for w in p.beta_by_estimator
        )
        for p in (told, ignored)
    ]
    assert off[0] < 0.002
    assert off[1] > 0.008
    assert told.status == "sound"
    setup = told.test.disks["fast"].setup
    assert setup.conductivity_W_mK < 0.96 * rig.disk_setup("fast").conductivity_W_mK  # at 90 degC
    open_ = seen_by(
        made,
        stating(uncertainty={"conductivity_slope_per_K": 5e-4, "specific_heat_slope_per_K": 5e-4}),
    )
    rows = {r.source: r for r in open_.budget.rows}
    assert rows["conductivity slope"].u_beta_steady > 0.002
    assert {"conductivity slope", "specific heat slope"} <= set(rows)
    for way, beta in open_.beta_by_estimator.items():
        assert abs(beta.value - made.told["beta"]) < 2.5 * beta.u, way


@pytest.mark.study
def test_the_effect_of_a_slope_is_what_another_slope_does() -> None:
    made = study_rig(SEED)
    u, at = 1e-4, (0.68, 750.0)
    test = with_linear_steel(seen_test(made, stating(uncertainty={"conductivity_slope_per_K": u})))
    rows, disk = fit_rows(test, 8.0), test.disks["fast"]

    def gap(slope: float, specific: float) -> tuple[Array, DiskWindow]:
        """Predicted less seen, and the window."""
        steel = replace(disk.setup.steel, conductivity_per_K=slope, specific_heat_per_K=specific)
        stated = replace(made.test.disks["fast"].setup, steel=steel)
        rim = float(lagged_window(test, disk, rows).rim.inputs[:, 1:4].mean())
        setup = linear_about(stated, steel.air_degC, steel.surface_degC, rim)
        window = lagged_window(test, replace(disk, setup=setup), rows)
        rest, power = window.rim.response(at[1])
        return rest + at[0] * power - window.y, window

    base, window = gap(0.0, 0.0)
    for found, moved in (
        (conductivity_slope_effect(window, *at, u), gap(u, 0.0)[0] - base),
        (specific_heat_slope_effect(window.rim, *at, u), gap(0.0, u)[0] - base),
    ):
        assert np.abs(moved).max() > 0.02
        # the column is of smooth readings, at the model's own outer row, some kelvin off at this share and h
        np.testing.assert_allclose(found, moved, atol=0.05 * np.abs(moved).max())


@pytest.mark.study
def test_a_column_of_the_fit_holds_no_noise_of_the_readings() -> None:
    """Else it would explain their noise: with it the share of the fast disk alone once came out 0.15 off."""
    made = study_rig(SEED)
    test = with_linear_steel(
        seen_test(made, stating(uncertainty={"conductivity_slope_per_K": 5e-4}))
    )
    window = lagged_window(test, test.disks["fast"], fit_rows(test, 8.0))
    column = conductivity_slope_effect(window, 0.68, 750.0, 5e-4)
    late = window.block_time_s > test.events.unload_s + 0.5
    noise = [np.std(np.diff(x[late][:150], n=3, axis=0)) for x in (column, window.y)]
    assert noise[0] < 0.002 * noise[1]


COLDER_K = -8.0


def spot(rng: np.random.Generator, h: float, air_degC: float, power_rel: float) -> SurfaceFlux:
    """What a heated spot tells of a surface: nine temperatures, 1 % of scatter, one error of the heater's power."""
    t = np.linspace(80.0, 160.0, 9)
    q = (
        h
        * (t - air_degC)
        * (1 + power_rel * rng.standard_normal())
        * (1 + 0.01 * rng.standard_normal(9))
    )
    return fit_surface_flux(t, q, power_rel)


def test_the_line_of_a_spot_is_that_of_a_regression() -> None:
    """T_a = -a/b of q = a + b T, cov(a, b) = -mean(T) var(b); the heater's error moves b alone."""
    t = np.linspace(80.0, 160.0, 9)
    q = 700.0 * (t - 55.0) * (1 + 0.01 * np.random.default_rng(0).standard_normal(9))
    told, line = fit_surface_flux(t, q, 0.02), stats.linregress(t, q)
    air = -line.intercept / line.slope
    variance = line.intercept_stderr**2 + (air**2 - 2 * air * t.mean()) * line.stderr**2
    assert told.heat_transfer_W_m2K == pytest.approx(line.slope)
    assert told.heat_transfer_u_W_m2K == pytest.approx(np.hypot(line.stderr, 0.02 * line.slope))
    assert told.air_degC == pytest.approx(air)
    assert told.air_u_K == pytest.approx(np.sqrt(variance) / line.slope)


def test_the_line_of_a_spot_holds_its_truth_as_often_as_it_says() -> None:
    rng, z = np.random.default_rng(3), []
    for _ in range(400):
        f = spot(rng, 700.0, 55.0, 0.02)
        z.append(
            [(f.heat_transfer_W_m2K - 700) / f.heat_transfer_u_W_m2K, (f.air_degC - 55) / f.air_u_K]
        )
    held = (np.abs(z) < 1.96).mean(axis=0)
    assert np.all(
        (held > 0.90) & (held < 0.98)
    )  # 7 degrees of freedom leave 91 % within 1.96 of the scatter's part


@pytest.mark.study
def test_a_measured_surface_tells_h_and_is_honest_where_the_ambient_is_not_what_cools() -> None:
    """The oil cools both running surfaces 8 K below the logged ambient: without the spot h is 4 u wrong."""
    truth = draw_truth(SEED, load_rig(), uncertain=True).with_film_air(COLDER_K)
    made, rng = study_rig(SEED, truth=truth), np.random.default_rng(SEED)
    told = {
        d: spot(rng, made.told[f"h_{d}"], made.told["ambient_degC"] + COLDER_K, 0.02)
        for d in ("fast", "slow")
    }
    p = seen_by(made, stating(**{d: {"surface": asdict(f)} for d, f in told.items()}))
    ignored = seen_by(made, load_rig())
    for d in ("fast", "slow"):
        h, before = p.both.estimates[f"h_{d}"], ignored.both.estimates[f"h_{d}"]
        assert h.u < 0.5 * before.u
        assert abs(h.value - made.told[f"h_{d}"]) < 2 * h.u
        assert p.estimates[f"joint {d}"].u <= 1.01 * ignored.estimates[f"joint {d}"].u
    fast = ignored.both.estimates["h_fast"]
    assert fast.value - made.told["h_fast"] > 3 * fast.u
    for way, beta in [*p.beta_by_estimator.items(), ("both", p.both.estimates["beta"])]:
        assert abs(beta.value - made.told["beta"]) < 2 * beta.u, way
    assert "measured surface flux" in [r.source for r in p.budget.rows]
    assert p.status == "sound"
