"""Recordings of the tests, made where they are missing and kept in ``.mutations_cache`` beside the project."""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from coverage import CoverageData

from tests.mutations.covering import Recording
from tests.mutations.targets import PACKAGES, judging

OPTIONS = ("-q", "-n", "0", "-p", "no:cacheprovider", "--hypothesis-seed=0")
THREADS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}  # of linear algebra, in every process


def recordings(root: Path, copy: Path) -> list[Recording]:
    """Return recordings of all judging tests, after running in ``copy`` those that changed since they were recorded.

    A recording holds for one state of the packages and of what the tests share; a test file counts as long as its text is the
    one that was run.
    """
    files = {path.relative_to(root).as_posix(): _digest([path]) for path in judging(root)}
    sources = [
        path for folder in (*PACKAGES, "tests") for path in sorted((root / folder).rglob("*.py"))
    ]
    shared = [
        path
        for path in sources
        if path.relative_to(root).as_posix() not in files and "mutations" not in path.parts
    ]
    folder = root / ".mutations_cache" / _digest(shared)
    missing = sorted(files.keys() - _current(folder, files).keys())
    if missing:
        print(f"recording which lines {len(missing)} test files execute ...", flush=True)
        _record(folder, copy, {name: files[name] for name in missing})
    found: dict[Path, set[str]] = {}
    for name, run in _current(folder, files).items():
        found.setdefault(run, set()).add(name)
    return [_read(run, names) for run, names in found.items()]


def _current(folder: Path, files: dict[str, str]) -> dict[str, Path]:
    """Return the run that holds each test file as it is now."""
    current = {}
    for table in sorted(folder.glob("*/files.json")):
        for name, digest in json.loads(table.read_text(encoding="utf-8")).items():
            if files.get(name) == digest:
                current[name] = table.parent
    return current


def _record(folder: Path, copy: Path, files: dict[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    run = Path(tempfile.mkdtemp(dir=folder))
    command = [sys.executable, "-m", "pytest", "-p", "tests.mutations.recording", *OPTIONS, *files]
    done = subprocess.run(
        command,
        cwd=copy,
        env={**os.environ, **THREADS, "PYTHONPATH": str(copy), "MUTATIONS_RECORD": str(run)},
        check=False,
    )
    if not (run / "tests.json").exists():
        raise SystemExit(
            f"pytest ended with exit code {done.returncode} before it recorded a test; see its output above"
        )
    (run / "files.json").write_text(json.dumps(files), encoding="utf-8")


def _read(run: Path, names: set[str]) -> Recording:
    lines = CoverageData(str(run / "lines.coverage"))
    lines.read()
    tests = json.loads((run / "tests.json").read_text(encoding="utf-8"))
    return Recording(
        lines, {test: told for test, told in tests.items() if test.partition("::")[0] in names}
    )


def _digest(paths: list[Path]) -> str:
    total = hashlib.sha256()
    for path in paths:
        total.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()[:16]
