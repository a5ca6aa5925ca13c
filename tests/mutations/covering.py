"""Which tests execute a mutant's lines, by recordings of one coverage database and one table of tests each."""

from dataclasses import dataclass
from pathlib import Path

from coverage import CoverageData

from tests.mutations.draw import Mutant
from tests.mutations.recording import FIXTURE, IMPORT


@dataclass(frozen=True)
class Recording:
    """One run of tests: coverage's database, and the outcome, seconds and fixtures of the tests in it that still count."""

    lines: CoverageData
    tests: dict[str, dict]


def seconds(recordings: list[Recording]) -> dict[str, float]:
    """Return how long every test took that passed."""
    return {
        name: told["seconds"]
        for recording in recordings
        for name, told in recording.tests.items()
        if told["passed"]
    }


def covering(mutant: Mutant, recordings: list[Recording]) -> list[str]:
    """Return the tests that execute the mutant and pass without it, fastest first.

    A line that runs while its module is imported, such as a default or a constant, is held to be executed by every test of what
    reads the private constant, of its function, or else of its module.
    """
    site = mutant.site
    lasting = seconds(recordings)
    found = _executing(mutant.path, site.statement, recordings)
    if found == {IMPORT} and site.readers:
        readers = set().union(
            *(_executing(mutant.path, lines, recordings) for lines in site.readers)
        )
        # what is read at import too may be read by all of the module
        found = found if IMPORT in readers else readers
    for lines in (site.within, (1, 10**9)):
        if found == {IMPORT} and lines is not None:
            found = _executing(mutant.path, lines, recordings)
    return sorted(found & lasting.keys(), key=lambda test: (lasting[test], test))


def within_budget(tests: list[str], lasting: dict[str, float], budget: float) -> list[str]:
    """Return the first tests that together last no longer than ``budget`` seconds, and at least one."""
    taken, total = tests[:1], lasting[tests[0]] if tests else 0.0
    for test in tests[1:]:
        total += lasting[test]
        if total > budget:
            break
        taken.append(test)
    return taken


def _executing(path: Path, lines: tuple[int, int], recordings: list[Recording]) -> set[str]:
    """Return the tests that execute one of the lines, and IMPORT where an import does."""
    found = set()
    for recording in recordings:
        by_line = recording.lines.contexts_by_lineno(path.as_posix())
        for context in {
            context
            for line, contexts in by_line.items()
            if lines[0] <= line <= lines[1]
            for context in contexts
        }:
            word, _, shared = context.partition(" ")
            if word == FIXTURE:
                name, _, base = shared.partition(" ")
                found |= {
                    test
                    for test, told in recording.tests.items()
                    if name in told["fixtures"] and test.startswith(base)
                }
            elif context == IMPORT or context in recording.tests:
                found.add(context)
    return found
