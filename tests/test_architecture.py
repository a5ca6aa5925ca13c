"""The arrows between packages: the contracts of import-linter in pyproject.toml, which name every package and miss no module."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.places import ROOT

CONTRACTS = {
    contract["name"]: contract
    for contract in tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "importlinter"
    ]["contracts"]
}
PACKAGES = {path.parent.name for path in (ROOT / "replay_kit").glob("*/__init__.py")}


def lint(folder):
    linter = Path(sys.executable).with_name("lint-imports")
    return subprocess.run(
        [linter, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False
    )


def test_imports_point_one_way():
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout


def test_every_package_is_a_layer_and_nothing_is_loose_beside_them():
    layers = CONTRACTS["data flows one way"]["layers"]
    assert {name for layer in layers for name in layer.replace("|", " ").split()} == PACKAGES
    assert {path.stem for path in (ROOT / "replay_kit").glob("*.py")} == {"__init__", "__main__"}


def test_planners_see_the_core_alone():
    forbidden = CONTRACTS["planners see values alone"]["forbidden_modules"]
    assert set(forbidden) == {f"replay_kit.{name}" for name in PACKAGES - {"core"}}


# Files, and a line that each may not hold.
WRONG = [
    ("replay_kit/workflows/replay/replay.py", "from planners import plan"),
    ("replay_kit/cli/plan.py", "from planners import plan"),
    ("replay_kit/results/slices.py", "import planners.hazards.domain as region"),
    ("replay_kit/core/geodesy.py", "from casadi import SX"),
    ("planners/hazards/domain.py", "from replay_kit.workflows.replay.account import Account"),
    ("replay_kit/estimator/filter.py", "import replay_kit.results.outcome.outcome"),
    ("replay_kit/estimator/filter.py", "from mcap.reader import make_reader"),
]


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    """What the linter says of a copy that holds all wrong lines."""
    folder = tmp_path_factory.mktemp("copy")
    for name in ("replay_kit", "planners"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    for module, line in WRONG:
        with (folder / module).open("a", encoding="utf-8") as file:
            file.write(f"\n{line}\n")
    done = lint(folder)
    assert done.returncode == 1
    return done.stdout


@pytest.mark.parametrize(("module", "line"), WRONG)
def test_a_wrong_import_is_found(broken, module, line):
    found, target = module.removesuffix(".py").replace("/", "."), line.split()[1]
    # of what is not the project's own the linter names the package alone
    named = target if target.startswith("replay_kit") else target.split(".")[0]
    assert f"{found} -> {named}" in broken
