"""Operating conditions and ambient, from columns or constants: hand-made logs with known means."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from tcdyn.core.errors import InputError
from tcdyn.partition.operating_conditions import (
    check_no_copies,
    constants_rel_u,
    disk_air,
    forces_N,
    speeds_rpm,
)
from tcdyn.rig.contact import Events
from tcdyn.rig.tables import Constant, air_name


def constants(**values: tuple[float, float]) -> dict[str, Constant]:
    return {name: Constant(value=value, u=u) for name, (value, u) in values.items()}


def test_relative_uncertainties_of_constants_are_those_of_the_quotients() -> None:
    """Load 5 of 200 N; 20 rpm from 3 and 4 of a difference of 500; speed ratio 3/1500 and
    4/1000."""
    load, sliding, ratio = constants_rel_u(
        [1500.0, 1000.0], [3.0, 4.0], constants(load_N=(200.0, 5.0))
    )
    assert load == pytest.approx(0.025)
    assert sliding == pytest.approx(5.0 / 500.0)
    assert ratio == pytest.approx(np.hypot(0.002, 0.004))
    assert constants_rel_u([1000.0, 1500.0], [0.0, 0.0], {}) == (0.0, 0.0, 0.0)


def test_constant_load_scales_with_friction_to_its_mean_over_the_steady_rows() -> None:
    t = np.arange(0.0, 100.0, 0.5)
    in_contact = (t > 20) & (t < 80)
    frame = pd.DataFrame({"time_s": t, "friction_N": np.where(in_contact, 6.0 + 0.05 * t, 0.0)})
    events = Events(20.0, 80.0, 0.1, 0.2, (80.0,))
    steady = (t > 60) & (t < 79)
    load, friction = forces_N(frame, events, steady, constants(load_N=(300.0, 3.0)))
    assert load[steady].mean() == pytest.approx(300.0)
    assert load[in_contact] / friction[in_contact] == pytest.approx(
        np.full(in_contact.sum(), load[100] / friction[100])
    )
    assert load[(t < 19) | (t > 81)] == pytest.approx(0.0)
    logged, _ = forces_N(frame.assign(load_N=np.where(in_contact, 250.0, 1.0)), events, steady, {})
    assert logged[(t > 25) & (t < 75)] == pytest.approx(249.0)  # minus the zero


def test_speeds_are_medians_under_load_or_constants() -> None:
    rpm = np.r_[np.full(10, 5.0), np.full(9, 1500.0), np.nan]
    frame = pd.DataFrame({"speed_fast_rpm": rpm})
    result = speeds_rpm(frame, np.arange(20) >= 10, constants(speed_slow_rpm=(1000.0, 4.0)))
    assert result == ([1500.0, 1000.0], [0.0, 4.0])


def rig_with_air_channels(surface: tuple[str, ...] = (), faces: tuple[str, ...] = ()) -> Any:
    """A rig whose disk has these air channels."""
    channels = SimpleNamespace(surface=surface, faces=faces)
    return cast(Any, SimpleNamespace(tables=lambda disk: SimpleNamespace(ambient=channels)))


def test_disk_air_is_the_channel_mean_with_the_uncertainty_of_their_scatter() -> None:
    """Means under load of 30, 32 and 37: sd 3.61 over the square root of 3; each drifts by 2 over
    the steady rows."""
    steady = np.arange(100) >= 50
    line = np.where(steady, 2.0 * (np.arange(100) - 74.5) / 50, 5.0)
    frame = pd.DataFrame({air_name(c): level + line for c, level in zip("abc", (30.0, 32.0, 37.0))})
    frame[air_name("d")] = 99.0  # constant channel
    result, findings = disk_air(
        frame, "fast", rig_with_air_channels(surface=tuple("abcd")), steady, {}
    )
    # no channel at the faces: the surface channels are used
    for location in (result.surface, result.faces):
        assert location == pytest.approx(33.0 + line)
    assert result.own_u_K == pytest.approx(np.std([30, 32, 37], ddof=1) / np.sqrt(3))
    assert [f.code for f in findings] == ["ambient.channels"]
    numbers = findings[0].numbers
    assert numbers["count"] == 3
    assert numbers["mean_degC"] == pytest.approx(33.0)
    assert numbers["drift_K"] == pytest.approx(2.0)
    with_ambient, _ = disk_air(
        frame.assign(ambient_degC=25.0), "fast", rig_with_air_channels(faces=("a",)), steady, {}
    )
    assert with_ambient.surface == pytest.approx(np.full(100, 25.0))
    assert with_ambient.faces == pytest.approx(30.0 + line)
    assert with_ambient.own_u_K == 0.0  # the scatter of one channel is unknown
    with pytest.raises(InputError, match="no channel of the air about the fast disk"):
        disk_air(frame, "fast", rig_with_air_channels(surface=("d",)), steady, {})
    from_constant, _ = disk_air(
        frame, "fast", rig_with_air_channels(), steady, constants(ambient_degC=(22.0, 1.0))
    )
    assert set(from_constant.surface) == set(from_constant.faces) == {22.0}


def test_identical_channels_raise_unless_they_are_constant() -> None:
    x = np.arange(5.0)
    frame = pd.DataFrame(
        {"fast_a_degC": x, "fast_b_degC": x, "fast_c_degC": 7.0, "fast_d_degC": 7.0}
    )
    with pytest.raises(InputError, match="one is a copy"):
        check_no_copies(frame, {}, "here")
    check_no_copies(frame, {"fast_b": "as requested"}, "here")
