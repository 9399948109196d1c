"""The rig file: what is printed can be read again, and says how columns and a single disk are written."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibration.errors import InputError
from calibration.rigfile import load_rig, rig_toml


def test_the_printed_file_reads_back_and_its_hints_are_valid(tmp_path: Path) -> None:
    text = rig_toml(load_rig())
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert load_rig(path) == load_rig()
    path.write_text(text.replace("# fast_a", "fast_a").replace("# [slow", "[slow").replace("# conduct", "conduct"))
    rig = load_rig(path)
    assert rig.common.columns == {"fast_a_degC": "TC1 fast"}
    assert (rig.fast.disk.conductivity_W_mK, rig.slow.disk.conductivity_W_mK) == (41.0, 43.0)
    assert "# fast_a" not in rig_toml(rig)  # no example once there are columns


def test_a_key_that_does_not_exist_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text("[disk]\nconductivity = 43\n")
    with pytest.raises(InputError, match=r"disk\.conductivity: there is no such key"):
        load_rig(path)
    path.write_text('{"disk": "fast"}')
    with pytest.raises(InputError, match="expected a rig file"):
        load_rig(path)
