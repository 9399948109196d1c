"""Fluids against published values."""

import numpy as np
import pandas as pd
import pytest

from immersion.fluids import fluid, fluid_from_table, read_fluid
from tcdyn.core.errors import InputError


def test_jet_oil_passes_through_its_data_sheet() -> None:
    oil = fluid("mobil-jet-ii")
    p = oil.at(np.array([15.0, 40.0, 100.0]))
    assert p.rho_kg_m3[0] == pytest.approx(1003.5)
    np.testing.assert_allclose(p.nu_m2_s[1:] * 1e6, [27.6, 5.1], rtol=1e-9)


def test_jet_oil_viscosity_is_the_published_walther_line() -> None:
    T = np.array([25.0, 60.0, 85.0, 130.0])
    line = 10 ** (10 ** (9.31259 - 3.66650 * np.log10(T + 273.15))) - 0.7
    # constants are printed to 6 digits: 1e-4 observed
    np.testing.assert_allclose(fluid("mobil-jet-ii").at(T).nu_m2_s * 1e6, line, rtol=2e-4)


@pytest.mark.parametrize(
    ("T", "rho", "c", "k", "mu", "beta"),
    [
        # NIST/IAPWS saturated or 0.1 MPa liquid water
        (20.0, 998.21, 4184.0, 0.5985, 1001.6e-6, 2.07e-4),
        (60.0, 983.20, 4185.0, 0.6510, 466.0e-6, 5.23e-4),
        (80.0, 971.79, 4196.0, 0.6670, 354.0e-6, 6.41e-4),
    ],
)
def test_water_agrees_with_steam_tables(
    T: float, rho: float, c: float, k: float, mu: float, beta: float
) -> None:
    p = fluid("water").at(T)
    assert float(p.rho_kg_m3) == pytest.approx(rho, rel=2e-5)  # accuracy of Kell's formula: 1e-5
    assert float(p.c_J_kgK) == pytest.approx(c, rel=5e-4)
    assert float(p.k_W_mK) == pytest.approx(k, rel=2e-3)  # stated uncertainty of conductivity 0.7 %
    assert float(p.nu_m2_s * p.rho_kg_m3) == pytest.approx(mu, rel=2e-3)
    assert float(p.beta_1_K) == pytest.approx(beta, rel=5e-3)


def test_table_written_from_a_fluid_reads_back_as_this_fluid(tmp_path) -> None:  # type: ignore[no-untyped-def]
    oil = fluid("mobil-jet-ii")
    T = np.array([15.0, 40.0, 70.0, 100.0, 140.0, 200.0])
    p = oil.at(T)
    path = tmp_path / "oil.csv"
    pd.DataFrame(
        {
            "T_degC": T,
            "rho_kg_m3": p.rho_kg_m3,
            "c_J_kgK": p.c_J_kgK,
            "k_W_mK": p.k_W_mK,
            "nu_m2_s": p.nu_m2_s,
        }
    ).to_csv(path, index=False)
    from_table = read_fluid(path)
    between = np.array([30.0, 85.0, 120.0])
    np.testing.assert_allclose(from_table.at(between).nu_m2_s, oil.at(between).nu_m2_s, rtol=1e-6)
    np.testing.assert_allclose(from_table.at(between).prandtl, oil.at(between).prandtl, rtol=1e-6)
    np.testing.assert_allclose(from_table.at(between).beta_1_K, oil.at(between).beta_1_K, rtol=1e-6)


def test_table_in_mm2_raises_with_the_remedy() -> None:
    in_mm2 = pd.DataFrame(
        {
            "T_degC": [20, 80],
            "rho_kg_m3": [990, 950],
            "c_J_kgK": 2000,
            "k_W_mK": 0.15,
            "nu_m2_s": [40.0, 8.0],
        }
    )
    with pytest.raises(InputError, match="m2/s, not mm2/s"):
        fluid_from_table(in_mm2, "bad")


def test_temperatures_outside_the_range_of_a_fluid_are_reported() -> None:
    assert fluid("water").check_range(20, 80) == ()
    (finding,) = fluid("water").check_range(20, 120)
    assert (finding.code, finding.subject, finding.numbers["known_degC"]) == (
        "fluid.extrapolated",
        "water",
        (0, 100),
    )
    with pytest.raises(InputError, match="unknown fluid"):
        fluid("honey")
