"""The arrows between packages, and the fixed top level."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_imports_point_one_way():
    linter = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_only_cli_imports_planners_and_only_planners_imports_casadi():
    for path in (ROOT / "replay_kit").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert path.name == "cli.py" or "planners" not in [
            word for line in text.splitlines() if "import" in line for word in line.split()
        ], path
        assert "import casadi" not in text, path
