"""The names through which tests and examples enter the product: the faces of its rooms, ``faces.toml`` beside this file."""

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FACES = tomllib.loads((ROOT / "tests/faces.toml").read_text(encoding="utf-8"))


def trespasses(root: Path) -> list[str]:
    """Return each import and dotted text in tests and examples that no face allows, with its file."""
    allowed = {module: names for room in FACES["faces"].values() for module, names in room.items()}
    found = []
    for path in [p for top in ("tests", "sample_logs") for p in sorted((root / top).rglob("*.py"))]:
        file = path.relative_to(root).as_posix()
        below = [
            f"{m}." for start, ms in FACES["below"].items() if file.startswith(start) for m in ms
        ]
        for node in ast.walk(ast.parse(path.read_bytes())):
            names = [
                (alias.name, "")
                for alias in getattr(node, "names", [])
                if isinstance(node, ast.Import)
            ]
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [(node.module or "", alias.name) for alias in node.names]
            elif isinstance(node, ast.Constant) and re.fullmatch(
                r"(\w+\.){2,}\w+", str(node.value)
            ):
                names = [(node.value, "")]
            for module, name in names:
                ours = re.match(r"(replay_kit|planners)\b", module) and (name or "." in module)
                if (
                    ours
                    and not f"{module}.".startswith(tuple(below))
                    and name not in allowed.get(module, ())
                ):
                    found.append(f"{file}: {module} {name}")
    return found


if __name__ == "__main__":
    entered = trespasses(ROOT)
    print(f"{len(entered):,} trespasses, {FACES['trespasses']:,} allowed; --list prints them")
    if "--list" in sys.argv:
        print(*entered, sep="\n")
    sys.exit(len(entered) > FACES["trespasses"])
