"""What ran and in what air, by columns or by what is stated: hand-made logs of which every mean is known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.rig.contact import Events
from tcdyn.rig.tables import Constant, air_name
from tcdyn.workflows.operating_conditions import (
    check_no_copies,
    constants_rel_u,
    disk_air,
    forces_N,
    speeds_rpm,
)


def stated(**values: tuple[float, float]) -> dict[str, Constant]:
    return {name: Constant(value=value, u=u) for name, (value, u) in values.items()}


def test_relative_uncertainties_of_what_is_stated_are_those_of_the_quotients() -> None:
    """Load 5 of 200 N; 20 rpm from 3 and 4 of a difference of 500; of the ratio 3/1500 and 4/1000."""
    load, sliding, ratio = constants_rel_u(
        [1500.0, 1000.0], [3.0, 4.0], stated(load_N=(200.0, 5.0))
    )
    assert load == pytest.approx(0.025)
    assert sliding == pytest.approx(5.0 / 500.0)
    assert ratio == pytest.approx(np.hypot(0.002, 0.004))
    assert constants_rel_u([1000.0, 1500.0], [0.0, 0.0], {}) == (0.0, 0.0, 0.0)


def test_a_stated_load_goes_with_the_friction_and_is_its_mean_over_the_steady_rows() -> None:
    t = np.arange(0.0, 100.0, 0.5)
    touching = (t > 20) & (t < 80)
    frame = pd.DataFrame({"time_s": t, "friction_N": np.where(touching, 6.0 + 0.05 * t, 0.0)})
    events, steady = Events(20.0, 80.0, 0.1, 0.2, (80.0,)), (t > 60) & (t < 79)
    load, friction = forces_N(frame, events, steady, stated(load_N=(300.0, 3.0)))
    assert load[steady].mean() == pytest.approx(300.0)
    assert load[touching] / friction[touching] == pytest.approx(
        np.full(touching.sum(), load[100] / friction[100])
    )
    assert load[(t < 19) | (t > 81)] == pytest.approx(0.0)
    logged, _ = forces_N(frame.assign(load_N=np.where(touching, 250.0, 1.0)), events, steady, {})
    assert logged[(t > 25) & (t < 75)] == pytest.approx(249.0)  # less its zero


def test_speeds_are_medians_under_load_or_what_is_stated() -> None:
    rpm = np.r_[np.full(10, 5.0), np.full(9, 1500.0), np.nan]
    frame = pd.DataFrame({"speed_fast_rpm": rpm})
    found = speeds_rpm(frame, np.arange(20) >= 10, stated(speed_slow_rpm=(1000.0, 4.0)))
    assert found == ([1500.0, 1000.0], [0.0, 4.0])


def air(surface: tuple[str, ...] = (), faces: tuple[str, ...] = ()) -> Any:
    """A rig whose disk has these channels of the air."""
    channels = SimpleNamespace(surface=surface, faces=faces)
    return cast(Any, SimpleNamespace(tables=lambda disk: SimpleNamespace(ambient=channels)))


def test_air_about_a_disk_is_the_mean_of_its_channels_and_known_as_well_as_they_agree() -> None:
    """Means under load of 30, 32 and 37: sd 3.61 over the root of three; each drifts by 2 over the steady rows."""
    steady = np.arange(100) >= 50
    line = np.where(steady, 2.0 * (np.arange(100) - 74.5) / 50, 5.0)
    frame = pd.DataFrame({air_name(c): v + line for c, v in zip("abc", (30.0, 32.0, 37.0))})
    frame[air_name("d")] = 99.0  # dead
    found, noticed = disk_air(frame, "fast", air(surface=tuple("abcd")), steady, {})
    for place in (found.surface, found.faces):  # no channel at the faces: as at the surface
        assert place == pytest.approx(33.0 + line)
    assert found.own_u_K == pytest.approx(np.std([30, 32, 37], ddof=1) / np.sqrt(3))
    assert [f.code for f in noticed] == ["ambient.channels"]
    told = noticed[0].numbers
    assert told["count"] == 3
    assert told["mean_degC"] == pytest.approx(33.0)
    assert told["drift_K"] == pytest.approx(2.0)
    both, _ = disk_air(frame.assign(ambient_degC=25.0), "fast", air(faces=("a",)), steady, {})
    assert both.surface == pytest.approx(np.full(100, 25.0))
    assert both.faces == pytest.approx(30.0 + line)
    assert both.own_u_K == 0.0  # of one channel nobody knows
    with pytest.raises(InputError, match="no channel of the air about the fast disk"):
        disk_air(frame, "fast", air(surface=("d",)), steady, {})
    room, _ = disk_air(frame, "fast", air(), steady, stated(ambient_degC=(22.0, 1.0)))
    assert set(room.surface) == set(room.faces) == {22.0}


def test_two_junctions_with_the_same_numbers_are_refused_and_two_that_rest_are_not() -> None:
    x = np.arange(5.0)
    frame = pd.DataFrame(
        {"fast_a_degC": x, "fast_b_degC": x, "fast_c_degC": 7.0, "fast_d_degC": 7.0}
    )
    with pytest.raises(InputError, match="one is a copy"):
        check_no_copies(frame, {}, "here")
    check_no_copies(frame, {"fast_b": "as told"}, "here")
