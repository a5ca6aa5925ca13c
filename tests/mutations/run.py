"""One mutant: written into a copy of the project, and the tests that execute it run until one fails."""

import ast
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from multiprocessing.context import ForkServerContext
from pathlib import Path

from tests.mutations.draw import Mutant
from tests.mutations.sites import apply
from tests.mutations.store import OPTIONS
from tests.mutations.targets import PACKAGES

SLACK = 60.0  # s for importing and collecting on a busy machine
SLOWER = 4.0  # times the recorded seconds after which a test is taken to loop for ever
NO_TESTS_FAILED, NO_SUCH_TEST = 0, 4  # exit codes of pytest
OURS = (*PACKAGES, "tests")


@dataclass(frozen=True)
class Verdict:
    """Whether the tests noticed a mutant, how, and in how many seconds."""

    killed: bool
    how: str
    seconds: float


def copied(root: Path, folder: Path) -> Path:
    """Copy what git knows or would add of the project at ``root`` into ``folder``, with the data beside it, and return the copy."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        if (root / name).is_file():
            target = folder / "project" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, target)
    if (root.parent / "shared").is_dir():
        (folder / "shared").symlink_to((root.parent / "shared").resolve())
    return folder / "project"


def warm(root: Path) -> ForkServerContext:
    """Return a server of processes that have imported what the project and its tests import from elsewhere."""
    names = set()
    for path in (path for name in OURS for path in (root / name).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Import():
                    names |= {alias.name for alias in node.names}
                case ast.ImportFrom(module=str(module), level=0):
                    names.add(module)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        sorted(name for name in names if name.partition(".")[0] not in (*OURS, "__main__"))
    )
    return context


def judged(
    mutant: Mutant, copy: Path, tests: list[str], limit: float, server: ForkServerContext
) -> Verdict:
    """Return what ``tests`` say of a mutant in no more than ``limit`` seconds; without an end by then they have noticed it."""
    path = copy / mutant.path
    source = path.read_text(encoding="utf-8")
    began = time.perf_counter()
    try:
        _replace(path, apply(source, mutant.site))
        killed, how = _pytest(copy, tests, limit, server)
    finally:
        _replace(path, source)
    return Verdict(killed, how, time.perf_counter() - began)


def _replace(path: Path, source: str) -> None:
    """Write a module with a time of its own: Python knows stale bytecode by whole seconds and the size."""
    later = path.stat().st_mtime_ns + 2 * 10**9
    path.write_text(source, encoding="utf-8")
    os.utime(path, ns=(later, later))


def _pytest(
    copy: Path, tests: list[str], limit: float, server: ForkServerContext
) -> tuple[bool, str]:
    """Return whether pytest failed, and the test that did or what else happened."""
    process = server.Process(target=_fails_first, args=(copy, tests))
    process.start()
    process.join(limit)
    if process.is_alive():
        os.killpg(process.pid, signal.SIGKILL)
        process.join()
        return True, f"no end within {limit:.0f} s"
    if process.exitcode == NO_TESTS_FAILED:
        return False, f"passes {len(tests)} tests"
    output = (copy.parent / "output.txt").read_text(encoding="utf-8", errors="replace")
    failures = [line for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    if process.exitcode == NO_SUCH_TEST and not failures:
        return False, "its tests cannot be selected: " + output.strip().rpartition("\n")[2]
    return True, failures[0] if failures else f"pytest ends with exit code {process.exitcode}"


def _fails_first(copy: Path, tests: list[str]) -> None:
    """Run tests in the copy until one fails, in a process of its own, and exit with pytest's code."""
    os.setsid()  # so that what the tests start can be stopped too
    for name in [name for name in sys.modules if name.partition(".")[0] in OURS]:
        del sys.modules[name]  # imported from the working tree, not from the copy
    sys.path.insert(0, str(copy))
    os.environ["PYTHONPATH"] = str(copy)
    os.chdir(copy)
    sys.dont_write_bytecode = (
        False  # the next mutant's run finds in the copy what this one compiles
    )
    output = os.open(copy.parent / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    import pytest

    # pytest would refuse plugins that are imported already
    sys.exit(
        pytest.main(
            [
                "-x",
                "--tb=no",
                "-rfE",
                "-W",
                "ignore::pytest.PytestAssertRewriteWarning",
                *OPTIONS,
                *tests,
            ]
        )
    )
