"""Every code block of every README, and of the pages beside them, runs; the set-up lines are run by .ci/run.

The commands of a shell block that share no file make chains, each a test of its own, so that the workers divide a long block.
"""

import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from matplotlib import pyplot

from replay_kit.cli.app import app
from replay_kit.cli.words import repeat_ensembles
from replay_kit.config.run import RunConfig, load_config
from replay_kit.workflows.fleet.missions import load_fleet
from tests.command import run_command
from tests.places import ROOT

READMES = [
    path
    for path in sorted(ROOT.rglob("*.md"))
    if not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
]
BLOCKS = [
    (path, f"{path.relative_to(ROOT)}-{k}", language, code)
    for path in READMES
    for k, (language, code) in enumerate(
        re.findall(
            r"^```(\w*)\n(.*?)^```", path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        )
    )
]
MAKES_SAMPLES = ROOT / "sample_logs" / "README.md"
SAMPLES = ("ensemble.nc", "truth.nc", "glider.mcap", "survey.mcap")


def set_up_lines() -> list[str]:
    """Return the lines that .ci/run takes out of the README, by running its own function for that."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (function,) = re.findall(r"^set_up\(\) \{.*\}$", script, re.MULTILINE)
    command = ["bash", "-euo", "pipefail", "-c"]
    lines = [
        subprocess.check_output([*command, f"{function}\nset_up {n}"], cwd=ROOT, text=True)
        for n in (1, 2, 3)
    ]
    assert lines.pop() == "", "more set-up lines than .ci/run runs"
    for n in (1, 2):
        assert f"$(set_up {n})" in script.replace(function, ""), f".ci/run does not run line {n}"
    return lines


def commands(code: str) -> list[list[str]]:
    """Return the words of each command of a shell block."""
    plain = re.fullmatch(r"[\w\s./,=:-]*", code.replace("\\\n", " "))
    assert plain, "a shell block holds commands of words that need no quotes"
    found = [line.split() for line in code.replace("\\\n", " ").splitlines() if line.strip()]
    own = all(
        words[0] == "replay-kit" or (words[0] == "python" and words[1].startswith("sample_logs/"))
        for words in found
    )
    assert own, "a shell block holds commands of replay-kit, and scripts beside the samples"
    return found


def names(words: list[str]) -> set[str]:
    """Return the words of a command that may name a file it reads or makes; the samples are there for all."""
    values = [
        word.split("=", 1)[-1] for word in words[2:] if "=" in word or not word.startswith("-")
    ]
    return {value.split("/")[0] for value in values if re.search("[a-z]", value)} - {"sample_logs"}


def chains(code: str) -> list[list[list[str]]]:
    """Return the commands of a shell block, those that may share a file together and in their order."""
    found: list[list[list[str]]] = []
    for words in commands(code):
        shared = [chain for chain in found if any(names(words) & names(other) for other in chain)]
        found = [chain for chain in found if chain not in shared]
        found.append([*(earlier for chain in shared for earlier in chain), words])
    return found


SHELL = [
    (path, name, code)
    for path, name, language, code in BLOCKS
    if language == "sh" and "pip install" not in code
]
# What takes long: the tests of studies, twins, conversion, saved estimates, figures and exports, of following, of --against, of what can
# be added and of fleets run each on less, .ci/run the main job from the other form of its log.
_LONG = (
    "experiment ",
    "synthesize --ensemble",
    "replay-kit qc ",
    "--save-estimate flow.nc",
    "walk/dives",
    "year/og1.nc",
    "extend.py",
    "sample_logs/glider.tlog --ensemble",
    "replay-kit fleet ",
)
_LONG_SCRIPTS = ("first.mcap", "rk.plan(result.estimate", "smooth(estimator, log")
CHAINS = [
    pytest.param(
        path,
        chain,
        id=f"{name}-{k}",
        marks=pytest.mark.full if any(word in code for word in _LONG) else (),
    )
    for path, name, code in SHELL
    for k, chain in enumerate(chains(code))
]
SCRIPTS = [
    pytest.param(
        code, id=name, marks=pytest.mark.full if any(word in code for word in _LONG_SCRIPTS) else ()
    )
    for _, name, language, code in BLOCKS
    if language == "python"
]
SETTINGS = [pytest.param(code, id=name) for _, name, language, code in BLOCKS if language == "toml"]


def with_samples(path: Path, folder: Path) -> None:
    """Put the samples beside what a README is about, unless it makes them."""
    if path != MAKES_SAMPLES:
        (folder / "sample_logs").symlink_to(ROOT / "sample_logs")


def test_every_block_says_its_language():
    for _, name, language, _ in BLOCKS:
        assert language in ("sh", "python", "json", "text", "toml"), (
            f"{name}: say what language a block is in"
        )


def test_the_set_up_blocks_are_the_lines_that_ci_runs():
    assert [
        code for path, _, _, code in BLOCKS if path == ROOT / "README.md" and "pip install" in code
    ] == set_up_lines()
    assert not any(
        "pip install" in code
        for path, _, language, code in BLOCKS
        if path != ROOT / "README.md" and language == "sh"
    )


def test_every_command_has_the_options_of_its_block():
    for _, name, code in SHELL:
        for words in commands(code):
            if words[0] == "replay-kit":
                app.parse_args(repeat_ensembles(words[1:]))  # refuses what it does not know
            else:
                assert (ROOT / words[1]).is_file(), name


@pytest.mark.parametrize(("path", "chain"), CHAINS)
def test_shell_blocks(path, chain, tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    with_samples(path, tmp_path)
    for words in chain:
        done = (
            run_command(tmp_path, words[1:])
            if words[0] == "replay-kit"
            else _script(tmp_path, words[1:])
        )
        assert done.returncode == 0, f"{' '.join(words)}\n{done.stderr}"
    if path == MAKES_SAMPLES:
        for name in SAMPLES:
            assert (tmp_path / name).read_bytes() == (path.parent / name).read_bytes(), (
                f"{name} came out otherwise"
            )


def _script(folder: Path, words: list[str]) -> subprocess.CompletedProcess[str]:
    """Run Python on a script beside the samples, in a process of its own: one of them changes a copy of the program."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    command = [sys.executable, "-W", "error", *words]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", ["pilot", "scientist"])
def test_the_scripts_of_the_walks_are_the_blocks_of_their_pages(name):
    page = ROOT / "sample_logs" / f"{name.upper()}.md"
    (block,) = [code for path, _, code in SHELL if path == page]
    script = (ROOT / "sample_logs" / f"{name}.sh").read_text(encoding="utf-8")
    assert script.endswith(f"\nset -e\n{block}")


@pytest.mark.parametrize("code", SCRIPTS)
def test_python_blocks(code, tmp_path, monkeypatch):
    (tmp_path / "sample_logs").symlink_to(ROOT / "sample_logs")
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        exec(compile(code, "README", "exec"), {"__name__": "__main__"})
    pyplot.close("all")


@pytest.mark.parametrize("code", SETTINGS)
def test_settings_blocks(code, tmp_path):
    (tmp_path / "run.toml").write_text(code, encoding="utf-8")
    if "[[mission]]" in code:
        assert load_fleet(tmp_path / "run.toml").mission
        return
    assert load_config(tmp_path / "run.toml") != RunConfig()


def test_samples_are_small():
    assert sum(path.stat().st_size for path in (ROOT / "sample_logs").iterdir()) < 8e6
