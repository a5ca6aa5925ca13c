import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutations.covering import Recording, covering, within_budget
from tests.mutations.draw import Mutant, drawn, mutants
from tests.mutations.sites import apply, sites
from tests.mutations.targets import is_target, targets
from tests.places import ROOT


def changed(source):
    return {apply(source, site) for site in sites(source)}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("y = a < b", {"y = a <= b", "y = a >= b"}),
        ("y = a is not b", {"y = a is b"}),
        ("y = a + b", {"y = a - b"}),
        ("y = (a + b) * c", {"y = (a - b) * c", "y = (a + b) / c", "y = ((-(a + b))) * c"}),
        ("y = f(ddof=1)", {"y = f(ddof=2)"}),
        ("y = f(copy=False)", {"y = f(copy=True)"}),
        ("y = 1e3", {"y = 2000.0"}),
        ("y = -x", {"y = x"}),
        ("y = not (a and b)", {"y =  (a and b)", "y = not (a or b)"}),
        ("y = x[:n]", {"y = x[1:n]", "y = x[:(n) + 1]"}),
        ("y = x[n:]", {"y = x[n:-1]", "y = x[(n) + 1:]"}),
        ("if a:\n    f()", {"if (not (a)):\n    f()", "if a:\n    pass"}),
        ("y = a if b else c", {"y = a if (not (b)) else c"}),
        ("y += x", {"y -= x", "pass"}),
        ("y.x = z", {"pass"}),
        ("raise ValueError(f'{a + 1}')", {"pass"}),
        ("y = 'ü', (a  # a + b\n  + b)", {"y = 'ü', (a  # a + b\n  - b)"}),
    ],
)
def test_every_change_of_a_statement(source, expected):
    assert changed(source) == expected


def test_wording_and_types_are_left_alone():
    source = '''
"""One and 2."""

def f(x: "int | None" = None, *, y: Literal[3]) -> tuple[int, 4]:
    """Return 5."""
    return zip(x, f"{x + 6}", "a" + y, strict=True)


class A:
    size: int

    def __repr__(self):
        return self.size + 7
'''
    assert changed(source) == set()


@pytest.mark.full
def test_every_mutant_of_the_project_can_be_compiled():
    for mutant in drawn(mutants(ROOT, targets(ROOT)), ROOT, 0, 100):
        compile(
            apply((ROOT / mutant.path).read_text(encoding="utf-8"), mutant.site),
            str(mutant.path),
            "exec",
        )


def test_a_seed_draws_the_same_mutants_also_from_a_file_that_moved(tmp_path):
    text = "\n".join(f"y{i} = {i} + x" for i in range(30))
    (tmp_path / "a.py").write_text(text)
    (tmp_path / "b.py").write_text("# a comment more\n" + text)
    one, again, other = (
        drawn(mutants(tmp_path, [Path(name)]), tmp_path, seed, 9)
        for name, seed in (("a.py", 1), ("b.py", 1), ("a.py", 2))
    )

    def lines(found):
        return [mutant.lines((tmp_path / mutant.path).read_text()) for mutant in found]

    assert lines(one) == lines(again)
    assert lines(one) != lines(other)


def test_words_in_a_path_leave_a_module_out():
    assert is_target(Path("planners/route/front.py"))
    assert not is_target(Path("planners/output/mission.py"))
    assert not is_target(Path("planners/output/mission.py"))
    assert not is_target(Path("replay_kit/studies/paper/rows.py"))


class _Lines:
    """What coverage's database says of one module."""

    def __init__(self, by_line):
        self.by_line = by_line

    def contexts_by_lineno(self, path):
        return self.by_line if path == "m.py" else {}


def test_tests_come_fastest_first_with_those_of_shared_fixtures_and_of_the_module_for_a_constant():
    lines = _Lines(
        {1: ["import"], 2: ["import"], 3: ["t.py::slow", "t.py::failing"], 4: ["fixture made t.py"]}
    )
    passed = {"t.py::slow": 3.0, "t.py::fast": 1.0, "other.py::test": 1.0}
    tests = {
        name: {
            "passed": True,
            "seconds": length,
            "fixtures": ["made"] if "fast" in name or "other" in name else [],
        }
        for name, length in passed.items()
    }
    tests["t.py::failing"] = {"passed": False, "seconds": 1.0, "fixtures": []}
    recorded = [Recording(lines, tests)]
    constant, first, second = (
        Mutant(Path("m.py"), site) for site in sites("A = 1\ndef f():\n    g()\n    h()\n")
    )
    assert covering(constant, recorded) == ["t.py::fast", "t.py::slow"]
    assert covering(first, recorded) == ["t.py::slow"]
    assert covering(second, recorded) == ["t.py::fast"]
    # a private constant counts for what reads it, unless that too runs at import
    for text, tests_of in (
        ("_A = 1\ndef f():\n    return _A\ndef g():\n    h()\n", ["t.py::slow"]),
        ("_A = 1\nB = _A\nf(B)\nh()\n", ["t.py::fast", "t.py::slow"]),
    ):
        read = Recording(
            _Lines({1: ["import"], 2: ["import"], 3: ["t.py::slow"], 4: ["fixture made t.py"]}),
            tests,
        )
        assert covering(Mutant(Path("m.py"), sites(text)[0]), [read]) == tests_of
    # a function that runs only while its module is imported
    (at_import, *_) = (
        Mutant(Path("m.py"), site)
        for site in sites("def made():\n    return 1\nA = made()\ndef f():\n    g()\n")
    )
    loading = Recording(_Lines({2: ["import"], 3: ["import"], 5: ["t.py::slow"]}), tests)
    assert covering(at_import, [loading]) == ["t.py::slow"]
    assert within_budget(["a", "b", "c"], {"a": 1.0, "b": 2.0, "c": 3.0}, 3.5) == ["a", "b"]
    assert within_budget(["c"], {"c": 3.0}, 1.0) == ["c"]


@pytest.mark.full
def test_the_survivor_of_a_small_project_is_named(tmp_path):
    (tmp_path / "planners").mkdir()
    (tmp_path / "planners" / "__init__.py").touch()
    (tmp_path / "planners" / "toy.py").write_text("def positive(value):\n    return value > 0\n")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "__init__.py").touch()
    (tmp_path / "tests" / "test_toy.py").write_text(
        "from planners.toy import positive\n\n\ndef test_positive():\n    assert positive(1)\n    assert not positive(-1)\n"
    )
    shutil.copy(ROOT / "tests" / "places.py", tmp_path / "tests" / "places.py")
    shutil.copytree(
        ROOT / "tests" / "mutations",
        tmp_path / "tests" / "mutations",
        ignore=shutil.ignore_patterns("__pycache__", "test_*"),
    )
    subprocess.run(["git", "init", "--quiet"], cwd=tmp_path, check=True)
    command = [
        sys.executable,
        "-m",
        "tests.mutations",
        "--seed",
        "1",
        "--workers",
        "2",
        "--json",
        "found.json",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (
        "planners/toy.py:2: comparison: passes 1 tests\n  - return value > 0\n  + return value >= 0\n"
        in done.stdout
    )
    assert "seed 1: 3 mutants, 2 killed, 1 survived, 67 % killed" in done.stdout
    rows = json.loads((tmp_path / "found.json").read_text())["mutants"]
    assert {row["after"]: row["killed"] for row in rows} == {
        "return value >= 0": False,
        "return value <= 0": True,
        "return value > 1": True,
    }
