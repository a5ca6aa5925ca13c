"""The weight of the project, which ``budget.toml`` beside this file limits.

``python tests/budget.py`` prints each line and ends with 1 where one is exceeded; it needs the standard library. ``--lower`` sets
the lines to what is there, where that is less. A file weighs

* of Python: 1 for each name, number, operator and text, and 1 for each 4 characters of a text beyond 24. Comments weigh nothing, docstrings
  of up to 600 characters neither: what ``ast`` takes for docstrings;
* of other text: 1 for each 4 bytes; Markdown counts in words. Any other file counts in bytes; the budget names its digest.
"""

import ast
import hashlib
import re
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from itertools import accumulate
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUDGET = tomllib.loads((ROOT / "tests/budget.toml").read_text(encoding="utf-8"))
FREE, BYTES, DOCUMENTED = 24, 4, 600
LAYOUT = ("COMMENT", "NL", "NEWLINE", "INDENT", "DEDENT", "ENDMARKER", "ENCODING")
UNCOUNTED = {getattr(tokenize, name) for name in LAYOUT}
# a formatted text is one token, as before Python 3.12
FORMATTED = {
    number: 1 for number, name in tokenize.tok_name.items() if name.endswith("STRING_START")
}
FORMATTED |= {
    number: -1 for number, name in tokenize.tok_name.items() if name.endswith("STRING_END")
}
# calls that make code of data, which would weigh less than code
MAKERS = {"exec", "eval", "compile", "__import__", "run_module", "run_path", "FunctionType"}
MAKERS |= {"spec_from_file_location", "makepyfile", "CodeType"}


def tracked(root: Path) -> list[Path]:
    """Return the files of the project; of a copy without git those outside of caches and environments."""
    if (root / ".git").exists():
        listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
        done = subprocess.run(listed, cwd=root, capture_output=True, text=True, check=True)
        found = sorted({root / name for name in done.stdout.splitlines()})
    else:
        other = re.compile(r"\.(?!ci$|github$|gitignore$)|(__pycache__|build|dist|.*\.egg-info)$")
        found = [p for p in root.rglob("*") if not any(map(other.match, p.relative_to(root).parts))]
    return [path for path in found if path.is_file()]


def weight(path: Path) -> list[int]:
    """Return the tokens, modules and bytes that a file adds to its line, and its tokens whatever their length."""
    data = path.read_bytes()
    if path.suffix == ".py":
        tokens, plain = python_tokens(data)
        return [tokens, int(path.name != "__init__.py"), 0, plain]
    if path.suffix == ".md":
        return [0, 0, 0, 0]
    return [0, 0, len(data), 0] if b"\0" in data else [-(-len(data) // BYTES), 0, 0, 0]


def python_tokens(data: bytes) -> tuple[int, int]:
    """Return the weight of Python, and the number of its tokens without texts in triple quotes."""
    total, plain, depth, free = 0, 0, 0, set()
    for token in tokenize.tokenize(iter(data.splitlines(keepends=True)).__next__):
        depth += FORMATTED.get(token.type, 0)
        if depth == 0 and token.type not in UNCOUNTED:
            total += 1
            plain += not token.string.startswith('"""')
    starts = [0, *accumulate(map(len, data.splitlines(keepends=True)))]
    for node in ast.walk(ast.parse(data)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            held = ast.get_docstring(node, clean=False)
            if held is not None and len(held) <= DOCUMENTED:
                free.add(id(node.body[0].value))
                total -= 1
        elif isinstance(node, ast.JoinedStr):
            free.update(id(part) for part in ast.walk(node) if part is not node)
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
        if (is_text or isinstance(node, ast.JoinedStr)) and id(node) not in free:
            ends = starts[node.end_lineno - 1] + node.end_col_offset
            size = ends - starts[node.lineno - 1] - node.col_offset
            total += -(-max(0, size - FREE) // BYTES)
    return total, plain


def spent(root: Path) -> tuple[dict[str, list[int]], list[str]]:
    """Return what each line holds, and which files have no line or are not the binary files of the budget."""
    lines, said = {line: [0] * 4 for line in BUDGET["lines"]}, []
    for path in tracked(root):
        name, held = path.relative_to(root).as_posix(), weight(path)
        parents = [parent.as_posix() for parent in Path(name).parents]
        line = next(
            (one for one in parents if one in lines and (one != "." or "/" not in name)), ""
        )
        if not line:
            said.append(f"{name}: no line of the budget")
            continue
        lines[line] = [a + b for a, b in zip(lines[line], held, strict=True)]
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if held[2] and BUDGET["binary"].get(name) != digest:
            said.append(f'{name}: expected the digest of the budget; got "{digest}"')
    return lines, said


def over_budget(root: Path, lines: dict[str, list[int]], said: list[str]) -> list[str]:
    """Return a sentence for everything that the budget does not allow, given what is ``spent``."""
    files = tracked(root)
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    packages = "\n".join(sorted(project["optional-dependencies"]["test"]))
    if hashlib.sha256(packages.encode()).hexdigest() != BUDGET["test_extra"]:
        said.append("pyproject.toml: the packages of the extra test are not those of the budget")
    words = sum(len(path.read_text("utf-8").split()) for path in files if path.suffix == ".md")
    made = Counter(call for path in (root / "tests").rglob("*.py") for call in made_code(path))
    counts = [("Markdown", "words", words, BUDGET["markdown_words"])]
    counts += [
        ("code from data", call, n, BUDGET["code_from_data"].get(call, 0))
        for call, n in made.items()
    ]
    for line, most in BUDGET["lines"].items():
        counts += zip(
            [line] * 3, ("tokens", "modules", "bytes"), lines[line][:3], most, strict=True
        )
    return said + [
        f"{a}: {n:,} {unit}, {most:,} allowed" for a, unit, n, most in counts if n > most
    ]


def made_code(path: Path) -> list[str]:
    """Return the calls and options of a file that make code of data."""
    found = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        called = getattr(node, "func", None)
        name = getattr(called, "id", getattr(called, "attr", ""))
        pattern = name == "compile" and getattr(getattr(called, "value", None), "id", "") == "re"
        found += [name] * (name in MAKERS and not pattern)
        found += ["-c"] * (isinstance(node, ast.Constant) and node.value == "-c")
    return found


if __name__ == "__main__":
    now, said = spent(ROOT)
    wrong = over_budget(ROOT, now, said)
    for title, tops in (("product", ("replay_kit", "planners")), ("all tests", ("tests",))):
        now[title] = list(map(sum, zip(*(now[n] for n in now if n.startswith(tops)), strict=True)))
    for line, (tokens, modules, size, plain) in now.items():
        print(f"{line:24}{tokens:9,} tokens ({plain:7,} plain){modules:5,} modules{size:11,} bytes")
    print(*wrong, sep="\n")
    if "--lower" in sys.argv:
        file = ROOT / "tests/budget.toml"
        text = file.read_text(encoding="utf-8")
        for line, most in BUDGET["lines"].items():
            least = ", ".join(f"{min(pair):_}" for pair in zip(now[line], most, strict=False))
            text = re.sub(rf'(?m)^"{re.escape(line)}" = .*', f'"{line}" = [{least}]', text)
        file.write_text(text, encoding="utf-8")
    sys.exit(bool(wrong))
