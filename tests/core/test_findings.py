"""Findings: every code has a message, findings survive a file, and channels are recognised by all
their names."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
from pydantic import BaseModel

from tcdyn.core.findings import Finding, Severity, channel_of, info, messages, unique, warning
from tcdyn.core.messages import FROM_FILES, MESSAGES

ROOT = Path(__file__).resolve().parents[2]
CONSTRUCTORS = {"info", "warning", "error", "info_or_warning", "Finding", "significant_test"}


def constructors_called(node: ast.AST) -> set[str]:
    """Constructors of findings that a call may reach: one by its name, or one of two by a
    condition."""
    if not isinstance(node, ast.Call):
        return set()
    ends = [node.func.body, node.func.orelse] if isinstance(node.func, ast.IfExp) else [node.func]
    return {end.id for end in ends if isinstance(end, ast.Name)} & CONSTRUCTORS


def codes_in_library() -> dict[str, str]:
    """Every code that the library passes to a constructor, and its file."""
    codes = {}
    for package in ("calibration", "immersion", "tcdyn"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                constructors = constructors_called(node)
                if not constructors:
                    continue
                assert isinstance(node, ast.Call)
                assert node.args, f"{path}, line {node.lineno}: a finding without a code"
                for constant in ast.walk(
                    node.args[bool({"info_or_warning", "significant_test"} & constructors)]
                ):
                    if isinstance(constant, ast.Constant) and isinstance(constant.value, str):
                        codes[constant.value] = path.name
    return codes


def string_constants_in_library() -> set[str]:
    """Every string constant outside the messages; a code may reach its constructor through a
    variable."""
    texts = set()
    for package in ("calibration", "immersion", "tcdyn"):
        for path in sorted((ROOT / package).rglob("*.py")):
            if "messages" in path.parts:
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    texts.add(node.value)
    return texts


@pytest.mark.e2e
def test_every_code_has_a_message_and_every_message_is_used() -> None:
    codes = codes_in_library()
    assert {c: f for c, f in codes.items() if c not in MESSAGES} == {}
    assert set(MESSAGES) - string_constants_in_library() - set(FROM_FILES) == set()


def test_unknown_code_raises() -> None:
    with pytest.raises(ValueError, match="no message"):
        info("no.such.code")


def test_finding_survives_a_json_round_trip() -> None:
    class Stored(BaseModel):
        findings: list[Finding]

    finding = warning(
        "from_file",
        where="x.csv",
        subject="fast_e_degC",
        text="it hums",
        count=3,
        channels=["a", "b"],
    )
    restored = Stored.model_validate_json(Stored(findings=[finding]).model_dump_json()).findings
    assert restored == [finding]
    assert restored[0].sentence == finding.sentence == "x.csv: it hums"
    from_later_version = Finding.from_dict({**finding.to_dict(), "code": "of.a.later.version"})
    assert from_later_version.sentence == "x.csv: it hums"
    assert from_later_version.severity is Severity.WARNING
    assert from_later_version.at("A1").sentence == "A1: x.csv: it hums"


def test_finding_of_an_earlier_version_gets_the_present_code() -> None:
    stored = {
        "code": "said",
        "grade": "look",
        "sentence": "it hums",
        "numbers": {"text": "it hums"},
    }
    assert Finding.from_dict(stored) == warning("from_file", text="it hums")
    assert Finding.from_dict(stored).sentence == "it hums"


def test_unique_findings_keep_their_order() -> None:
    first = info("from_file", text="b")
    second = warning("from_file", text="a")
    assert unique([first, second, first]) == (first, second)
    assert messages(f.at("A1") for f in (first, second)) == ("A1: b", "A1: a")


@pytest.mark.parametrize("name", ["e", "e_degC", "fast_e_degC", "slow_e", "rig2_e_degC"])
def test_channel_is_recognised_by_all_its_names(name: str) -> None:
    assert channel_of(name) == "e"


@pytest.mark.parametrize(
    "name", ["fast_b_u_K", "slow_t1_u_K", "b_u_K", "fast_b_u_degF", "fast_load_N", "fast_u_m_s"]
)
def test_column_of_another_quantity_is_no_channel(name: str) -> None:
    assert channel_of(name) == ""
    assert warning("from_file", subject=name, text="").channels == ()


def test_numbers_must_be_plain_values() -> None:
    with pytest.raises(TypeError, match="cannot be stored"):
        info("from_file", text=object())
    assert math.isnan(info("from_file", text="x", u=math.nan).numbers["u"])


def test_message_about_cells_without_number_counts_the_others() -> None:
    one, three = (warning("text.no_number", subject="a", text="abc", count=k) for k in (1, 3))
    assert "more" not in str(one)
    assert "(and 2 more)" in str(three)
