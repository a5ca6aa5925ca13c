"""Inputs that guided fuzzing began with or found: no exception but ours."""

import pytest

from tests.fuzz.parsers import CORPUS, PARSERS

INPUTS = sorted(path for path in CORPUS.rglob("*") if path.is_file())


@pytest.mark.parametrize("path", INPUTS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_an_input_of_the_corpus(path):
    PARSERS[path.parent.name](path.read_bytes())


def test_every_parser_has_inputs():
    assert {path.parent.name for path in INPUTS} == set(PARSERS)
