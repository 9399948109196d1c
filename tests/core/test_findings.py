"""Findings: every code has words, nothing of a finding is lost in a file, a channel is known by any of its names."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
from pydantic import BaseModel

from tcdyn.core.findings import Finding, Severity, channel_of, info, messages, unique, warning
from tcdyn.core.messages import FROM_FILES, MESSAGES

ROOT = Path(__file__).resolve().parents[2]
MAKERS = {"info", "warning", "error", "info_or_warning", "Finding", "significant_test"}


def makers_of(node: ast.AST) -> set[str]:
    """Which makers of findings a call may go to: one by its name, or one of two by a condition."""
    if not isinstance(node, ast.Call):
        return set()
    ends = [node.func.body, node.func.orelse] if isinstance(node.func, ast.IfExp) else [node.func]
    return {end.id for end in ends if isinstance(end, ast.Name)} & MAKERS


def codes_made() -> dict[str, str]:
    """Every code that the library gives to a maker, and the file that does."""
    made = {}
    for room in ("calibration", "immersion", "tcdyn"):
        for path in sorted((ROOT / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                maker = makers_of(node)
                if not maker:
                    continue
                assert isinstance(node, ast.Call)
                assert node.args, f"{path}, line {node.lineno}: a finding without a code"
                for part in ast.walk(
                    node.args[bool({"info_or_warning", "significant_test"} & maker)]
                ):
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        made[part.value] = path.name
    return made


def texts_of_the_library() -> set[str]:
    """Every text constant outside the messages; a code may reach its maker through a variable."""
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
def test_every_code_made_has_words_and_every_words_are_made() -> None:
    made = codes_made()
    assert {c: f for c, f in made.items() if c not in MESSAGES} == {}
    assert set(MESSAGES) - texts_of_the_library() - set(FROM_FILES) == set()


def test_an_unknown_code_is_an_error() -> None:
    with pytest.raises(ValueError, match="no message"):
        info("no.such.code")


def test_a_finding_comes_back_from_a_file_with_the_sentence_it_had() -> None:
    class Kept(BaseModel):
        findings: list[Finding]

    found = warning(
        "said", where="x.csv", subject="fast_e_degC", text="it hums", count=3, channels=["a", "b"]
    )
    back = Kept.model_validate_json(Kept(findings=[found]).model_dump_json()).findings
    assert back == [found]
    assert back[0].sentence == found.sentence == "x.csv: it hums"
    newer = Finding.from_dict({**found.to_dict(), "code": "of.a.later.version"})
    assert newer.sentence == "x.csv: it hums"
    assert newer.severity is Severity.WARNING
    assert newer.at("A1").sentence == "A1: x.csv: it hums"


def test_findings_are_told_once_and_keep_their_order() -> None:
    first, second = info("said", text="b"), warning("said", text="a")
    assert unique([first, second, first]) == (first, second)
    assert messages(f.at("A1") for f in (first, second)) == ("A1: b", "A1: a")


@pytest.mark.parametrize("name", ["e", "e_degC", "fast_e_degC", "slow_e", "rig2_e_degC"])
def test_a_channel_is_known_by_any_of_its_names(name: str) -> None:
    assert channel_of(name) == "e"


def test_numbers_are_plain() -> None:
    with pytest.raises(TypeError, match="cannot be stored"):
        info("said", text=object())
    assert math.isnan(info("said", text="x", u=math.nan).numbers["u"])
