"""What is mutated and which tests judge it: packages, and words in the names of folders and modules that are left out.

Names that move need no change here: a module is left out for a word of its path below the package, wherever it lies.
"""

from pathlib import Path

PACKAGES = ("replay_kit", "planners")
# Commands, settings, wording, pictures, studies and made-up data; logs have the oracle of ``tests.fuzz``.
LEFT_OUT = frozenset(
    {
        *("cli", "config", "errors"),
        *(
            "explain",
            "figures",
            "findings",
            "output",
            "pictures",
            "provenance",
            "report",
            "tables",
            "text",
        ),
        *("benchmarks", "experiments", "logs", "studies", "twins"),
    }
)
# Tests that start other processes, need data from elsewhere or judge no line of their own.
TESTS_LEFT_OUT = (
    *("tests/benchmarks", "tests/fuzz", "tests/mutations", "tests/validation"),
    *("tests/test_architecture.py", "tests/test_readme.py"),
)


def is_target(path: Path) -> bool:
    """Return whether a module is mutated; ``path`` is relative to the project's root."""
    words = {word for part in path.with_suffix("").parts[1:] for word in part.split("_")}
    return path.parts[0] in PACKAGES and path.suffix == ".py" and not words & LEFT_OUT


def targets(root: Path) -> list[Path]:
    """Return the modules of the project at ``root`` that are mutated, relative to it, sorted."""
    modules = (
        path.relative_to(root) for package in PACKAGES for path in (root / package).rglob("*.py")
    )
    return sorted(filter(is_target, modules))


def judging(root: Path) -> list[Path]:
    """Return the test files of the project at ``root`` that judge a mutant, sorted."""
    files = sorted((root / "tests").rglob("test_*.py"))
    left_out = [root / name for name in TESTS_LEFT_OUT]
    return [path for path in files if not any(path.is_relative_to(out) for out in left_out)]
