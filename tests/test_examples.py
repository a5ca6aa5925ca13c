"""The example that extends a copy of the packages: what it changes stands where it looks for it."""

import runpy

import pytest

from tests.places import ROOT

ADDITIONS = runpy.run_path(str(ROOT / "sample_logs" / "examples" / "extend.py"))["ADDITIONS"]


@pytest.mark.parametrize(
    ("name", "before"), [(name, before) for name, before, _ in ADDITIONS if before]
)
def test_each_line_that_the_example_extends_stands_once_in_its_file(name, before):
    assert (ROOT / name).read_text(encoding="utf-8").count(before) == 1
