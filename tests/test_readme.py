"""Every code block of every README runs; the set-up lines are run by .ci/run."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from replay_kit.config import RunConfig, load_config
from tests.places import ROOT

READMES = [path for path in sorted(ROOT.rglob("README.md")) if not any(part.startswith(".") for part in path.relative_to(ROOT).parts)]
BLOCKS = [
    pytest.param(path, language, code, id=f"{path.relative_to(ROOT)}-{k}")
    for path in READMES
    for k, (language, code) in enumerate(re.findall(r"^```(\w*)\n(.*?)^```", path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE))
]


def set_up_lines() -> list[str]:
    """Return the lines that .ci/run takes out of the README, by running its own function for that."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (function,) = re.findall(r"^set_up\(\) \{.*\}$", script, re.MULTILINE)
    command = ["bash", "-euo", "pipefail", "-c"]
    lines = [subprocess.check_output([*command, f"{function}\nset_up {n}"], cwd=ROOT, text=True) for n in (1, 2, 3)]
    assert lines.pop() == "", "README has more set-up lines than .ci/run runs"
    for n in (1, 2):
        assert f"$(set_up {n})" in script.replace(function, ""), f".ci/run does not run line {n}"
    return lines


def test_the_set_up_blocks_are_the_lines_that_ci_runs():
    blocks = [code for path, _, code in (block.values for block in BLOCKS) if path == ROOT / "README.md" and "pip install" in code]
    assert blocks == set_up_lines()


@pytest.mark.parametrize(("path", "language", "code"), BLOCKS)
def test_code_blocks(path, language, code, tmp_path):
    assert language in ("sh", "python", "json", "text", "toml"), f"{path}: say what language a block is in"
    if language == "toml":
        (tmp_path / "run.toml").write_text(code, encoding="utf-8")
        assert load_config(tmp_path / "run.toml") != RunConfig()
    if language not in ("sh", "python"):
        return
    if "pip install" in code:
        assert code in set_up_lines(), f"{path}: this set-up line is not one that .ci/run takes out and runs"
        return
    if path.parent == ROOT:
        (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "MPLBACKEND": "agg",
    }
    command = ["bash", "-euo", "pipefail", "-c", code] if language == "sh" else [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if path.parent.name == "sample_logs":
        for name in ("ensemble.nc", "truth.nc", "glider.mcap", "glider.tlog", "survey.mcap"):
            assert (tmp_path / name).read_bytes() == (path.parent / name).read_bytes(), f"{name} came out otherwise"


def test_samples_are_small():
    assert sum(path.stat().st_size for path in (ROOT / "sample_logs").iterdir()) < 8e6


def test_the_picture_is_the_script_s():
    assert shutil.which("bash")
    assert (ROOT / "sample_logs" / "estimate.png").read_bytes()[:4] == b"\x89PNG"
