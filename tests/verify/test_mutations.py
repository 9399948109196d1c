"""The thirty mutations stand where they are said to, and are seen."""

import ast

import pytest

from tests.verify.mutations import MUTATIONS, ROOT, Mutation, study


def test_there_are_thirty_in_fifteen_files_and_no_two_alike():
    assert len(MUTATIONS) == 30
    assert len({(m.file, m.old) for m in MUTATIONS}) == 30
    assert len({m.file for m in MUTATIONS}) >= 15


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.what)
def test_each_changes_one_place_and_leaves_python(mutation: Mutation):
    text = (ROOT / mutation.file).read_text(encoding="utf-8")
    changed = mutation.changed(text)
    assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text))  # code, not a comment
    assert (ROOT / mutation.tests).is_file()


def test_a_text_that_stands_there_twice_is_refused():
    with pytest.raises(ValueError, match="stands there 2 times"):
        Mutation("x", "f.py", "a", "b", "t.py").changed("a a")


@pytest.mark.study
def test_verify_sees_24_of_30_mutations_and_a_unit_test_all_but_one_of_the_others():
    found = study().values()
    assert sum(c.by_verify for c in found) >= 24
    assert sum(c.by_any for c in found) >= 29
