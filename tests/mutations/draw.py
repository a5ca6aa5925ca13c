"""The draw: which of all changes a seed picks."""

import hashlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.mutations.sites import Site, apply, sites


@dataclass(frozen=True)
class Mutant:
    """One change of one module; ``path`` is relative to the project's root."""

    path: Path
    site: Site

    def lines(self, source: str) -> tuple[str, str]:
        """Return the first changed line of the module's text before and after, without the blanks around."""
        index = self.site.line - 1
        return tuple(
            (text.splitlines()[index : index + 1] or [""])[0].strip()
            for text in (source, apply(source, self.site))
        )


def mutants(root: Path, paths: list[Path]) -> list[Mutant]:
    """Return every change of the modules ``paths`` below ``root``."""
    return [
        Mutant(path, site)
        for path in paths
        for site in sites((root / path).read_text(encoding="utf-8"))
    ]


def drawn(every: list[Mutant], root: Path, seed: int, count: int) -> list[Mutant]:
    """Return ``count`` of the mutants: those whose digest of the seed and of the changed line comes first.

    The digest knows the line's text, not its place: a mutant remains drawn where the code around it changes or the file moves.
    """
    sources = {
        path: (root / path).read_text(encoding="utf-8").splitlines(keepends=True)
        for path in {mutant.path for mutant in every}
    }
    starts = {path: _starts(lines) for path, lines in sources.items()}
    seen: Counter[str] = Counter()
    ranked = []
    for mutant in every:
        site, line = mutant.site, sources[mutant.path][mutant.site.line - 1]
        column = site.start - starts[mutant.path][site.line - 1] - (len(line) - len(line.lstrip()))
        text = f"{seed}|{line.strip()}|{column}|{site.kind}|{site.after}"
        seen[text] += 1
        ranked.append((hashlib.sha256(f"{text}|{seen[text]}".encode()).digest(), mutant))
    ranked.sort(key=lambda pair: pair[0])
    return sorted(
        (mutant for _, mutant in ranked[:count]), key=lambda mutant: (mutant.path, mutant.site)
    )


def _starts(lines: list[str]) -> list[int]:
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))
    return starts
