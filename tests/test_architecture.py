"""The arrows between packages: the contracts of import-linter in pyproject.toml, and that they miss no module."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.places import ROOT

CONTRACTS = {
    contract["name"]: contract
    for contract in tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
}
MODULES = {f"replay_kit.{path.stem}" for path in (ROOT / "replay_kit").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
MODULES -= {"replay_kit.__init__"}
# what a planner may see: values, geodesy, the flow and its kernels
SEEN_BY_PLANNERS = {f"replay_kit.{name}" for name in ("types", "errors", "geodesy", "flow", "flow_netcdf", "kernels")}


def lint(folder):
    linter = Path(sys.executable).with_name("lint-imports")
    return subprocess.run([linter, "--no-cache"], cwd=folder, capture_output=True, text=True, check=False)


def test_imports_point_one_way():
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout


def test_no_module_is_left_out_of_the_contracts():
    layers = CONTRACTS["data flows one way"]["layers"]
    named = {module for layer in layers for module in layer.replace("|", " ").replace(":", " ").split()}
    assert named == MODULES
    (forbidden,) = (contract["forbidden_modules"] for contract in CONTRACTS.values() if contract.get("source_modules") == ["planners"])
    assert set(forbidden) == MODULES - SEEN_BY_PLANNERS


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("replay_kit/replay.py", "from planners import plan"),
        ("replay_kit/twin/make.py", "import planners.region as region"),
        ("replay_kit/geodesy.py", "from casadi import SX"),
        ("planners/region.py", "from replay_kit.tally import Tally"),
        ("replay_kit/estimator/filter.py", "import replay_kit.report"),
    ],
)
def test_a_wrong_import_is_found(tmp_path, module, line):
    for name in ("replay_kit", "planners"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with (tmp_path / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{line}\n")
    done = lint(tmp_path)
    assert done.returncode == 1
    assert "BROKEN" in done.stdout
