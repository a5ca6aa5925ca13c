"""Plant the faults of ``faults.toml`` one by one in a copy of the project: ``python -m tests.faults [NAMES] [--workers 1]``.

A fault is noticed when a test fails with it and passes without it. Exit code 1 when one without a stated reason is not noticed.
"""

import argparse
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from tests.faults.listed import ROOT, Fault, failing, faults


def copied(folder: Path) -> Path:
    """Copy what git tracks, beside the shared data."""
    project = folder / "project"
    project.mkdir()
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True).stdout
    # a copy that is no repository, as that of .ci/run, is whole
    chosen = ["--null", "--files-from=-"] if names else ["--exclude=.venv", "."]
    tar = subprocess.run(
        ["tar", "--create", *chosen], cwd=ROOT, input=names, capture_output=True, check=True
    )
    subprocess.run(["tar", "--extract"], cwd=project, input=tar.stdout, check=True)
    if (ROOT.parent / "shared").exists():
        (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())
    return project


def tried(fault: Fault, project: Path) -> str | None:
    """Return the test that notices a fault; None when none of those tried does."""
    file = project / fault.file
    sound = file.read_text()
    try:
        file.write_text(fault.planted(sound))
        # one after another, as pytest sorts folders that hold one another
        each = (failing(project, tests) for tests in fault.tests_in_turn(project))
        found = next((test for test in each if test), None)
    finally:
        file.write_text(sound)
    if found is not None and failing(project, found) is not None:
        raise RuntimeError(f"{fault.name}: {found} fails without a fault too")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAMES", help="faults or rooms; default: all")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    wanted = [one for one in faults() if not given.names or {one.name, one.room} & {*given.names}]
    missed, noticed = [], 0
    with tempfile.TemporaryDirectory() as folder:
        copies: SimpleQueue[Path] = SimpleQueue()
        for number in range(given.workers):
            (Path(folder) / str(number)).mkdir()
            copies.put(copied(Path(folder) / str(number)))

        def one(fault: Fault) -> tuple[Fault, str | None]:
            project = copies.get()
            try:
                return fault, tried(fault, project)
            finally:
                copies.put(project)

        with ThreadPoolExecutor(given.workers) as pool:
            for fault, test in pool.map(one, wanted):
                said = (
                    f"noticed by {test}"
                    if test
                    else f"not noticed {fault.reason and f'({fault.reason})'}"
                )
                print(f"{fault.name} {fault.file}: {fault.what}: {said}", flush=True)
                noticed += test is not None
                if test is None and not fault.reason:
                    missed.append(fault.name)
    print(f"{noticed} of {len(wanted)} noticed; without a reason not: {' '.join(missed) or 'none'}")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
