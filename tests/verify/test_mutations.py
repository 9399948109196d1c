"""The thirty mutations change their source, and are detected."""

import ast

import numpy as np
import pytest

from tests.verify.mutations import MUTATIONS, ROOT, Mutation, study


def test_there_are_thirty_different_mutations_in_fifteen_files():
    assert len(MUTATIONS) == 30
    assert len({(m.file, m.old) for m in MUTATIONS}) == 30
    assert len({m.file for m in MUTATIONS}) >= 15


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.what)
def test_each_mutation_changes_one_location_and_leaves_valid_python(mutation: Mutation):
    text = (ROOT / mutation.file).read_text(encoding="utf-8")
    changed = mutation.changed(text)
    assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text))  # code, not a comment
    assert (ROOT / mutation.tests).is_file()


def test_text_that_occurs_twice_raises():
    with pytest.raises(ValueError, match="stands there 2 times"):
        Mutation("x", "f.py", "a", "b", "t.py").changed("a a")


@pytest.mark.long
@pytest.mark.study
def test_verify_detects_24_of_30_mutations_and_unit_tests_all_but_one(draws):
    count = draws(len(MUTATIONS))
    chosen = np.linspace(1, len(MUTATIONS), count).astype(int).tolist()
    results = study(chosen).values()
    assert len(results) == count
    assert sum(c.by_verify for c in results) >= count - 6
    assert sum(c.by_any for c in results) >= count - 1
    if count < len(MUTATIONS):
        assert sum(c.by_verify for c in results) > count // 2
