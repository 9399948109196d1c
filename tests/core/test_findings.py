"""Findings: every code has words, nothing of a finding is lost in a file, a channel is known by any of its names."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import pytest
from pydantic import BaseModel

from tcdyn.core.findings import Finding, Grade, channel_of, look, note, once, sentences
from tcdyn.core.messages import OLD, WORDS

ROOT = Path(__file__).resolve().parents[2]
MAKERS = {"note", "look", "refuse", "by_share", "Finding", "_failed"}


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
                for part in ast.walk(node.args[bool({"by_share", "_failed"} & maker)]):
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        made[part.value] = path.name
    return made


def test_every_code_made_has_words_and_every_words_are_made() -> None:
    made = codes_made()
    assert {c: f for c, f in made.items() if c not in WORDS} == {}
    assert set(WORDS) - set(made) - set(OLD) == set()


def test_an_unknown_code_is_an_error() -> None:
    with pytest.raises(ValueError, match="no words"):
        note("no.such.code")


def test_a_finding_comes_back_from_a_file_with_the_sentence_it_had() -> None:
    class Kept(BaseModel):
        findings: list[Finding]

    found = look(
        "said", where="x.csv", subject="fast_e_degC", text="it hums", count=3, channels=["a", "b"]
    )
    back = Kept.model_validate_json(Kept(findings=[found]).model_dump_json()).findings
    assert back == [found]
    assert back[0].sentence == found.sentence == "x.csv: it hums"
    newer = Finding.from_dict({**found.to_dict(), "code": "of.a.later.version"})
    assert newer.sentence == "x.csv: it hums"
    assert newer.grade is Grade.LOOK
    assert newer.at("A1").sentence == "A1: x.csv: it hums"


def test_findings_are_told_once_and_keep_their_order() -> None:
    first, second = note("said", text="b"), look("said", text="a")
    assert once([first, second, first]) == (first, second)
    assert sentences(f.at("A1") for f in (first, second)) == ("A1: b", "A1: a")


@pytest.mark.parametrize("name", ["e", "e_degC", "fast_e_degC", "slow_e", "rig2_e_degC"])
def test_a_channel_is_known_by_any_of_its_names(name: str) -> None:
    assert channel_of(name) == "e"


def test_numbers_are_plain() -> None:
    with pytest.raises(TypeError, match="no number"):
        note("said", text=object())
    assert math.isnan(note("said", text="x", u=math.nan).numbers["u"])
