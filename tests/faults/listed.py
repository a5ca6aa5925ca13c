"""The faults of ``faults.toml``, and a run of the tests that should notice one."""

import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Fault:
    """One line of the list."""

    name: str
    room: str
    file: str
    text: str
    faulty: str
    what: str
    tests: tuple[str, ...] = ()
    reason: str = ""

    def planted(self, sound: str) -> str:
        return sound.replace(self.text, self.faulty)

    def tests_in_turn(self, root: Path) -> list[str]:
        """Those named, the folders that mirror the file's, innermost first, and the properties."""
        parts = Path(self.file).relative_to("replay_kit" if self.room != "planners" else ".").parts
        mirrors = ["/".join(("tests", *parts[:n])) for n in range(len(parts) - 1, 0, -1)]
        beside = f"{mirrors[0]}/test_{parts[-1]}"
        wanted = [*self.tests, beside, mirrors[0], "tests/properties", *mirrors[1:]]
        return list(dict.fromkeys(each for each in wanted if (root / each.split("::")[0]).exists()))


def faults() -> list[Fault]:
    rooms = tomllib.loads((Path(__file__).parent / "faults.toml").read_text())
    found = []
    for room, lines in rooms.items():
        top = "" if room == "planners" else "replay_kit/"
        for name, (file, text, faulty, what, *rest) in lines.items():
            reason = rest[0] if rest and not rest[0].startswith("tests/") else ""
            tests = () if reason else tuple(rest)
            path = f"planners/{file}" if not top else top + file
            found.append(Fault(name, room, path, text, faulty, what, tests, reason))
    return found


def failing(root: Path, tests: str) -> str | None:
    """Return the first test that fails in a copy of the tree; None when all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-n", "0", "-p", "no:cacheprovider", tests]
    done = subprocess.run(
        command,
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
    )
    if done.returncode in (0, 5):  # none was left of those marked full
        return None
    found = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", done.stdout, re.MULTILINE)
    if done.returncode not in (1, 2) or found is None:
        raise RuntimeError(f"pytest {tests}:\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return found.group(1)
