"""The licence of every package that an installation brings: ``python -m tests.release.licences [EXTRA...]``.

Walks from the project's requirements to theirs, as they are installed here, and prints name, version and licence. Ends with exit
code 1 where a package is under the GPL or AGPL, or states no licence: these are not to be depended on.
"""

import re
import sys
from collections.abc import Iterable
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

PROJECT = "replay-kit"
# What these state nowhere in their metadata, or not exactly, read from the licence in the package.
READ_BY_HAND = {
    # under the GPL is its Emacs mode alone, which wheels do not hold
    "docutils": "Public Domain, BSD-2-Clause",
    "requests-unixsocket": "Apache-2.0",
    "rockit-meco": "LGPL-3.0",
}
_REFUSED = re.compile(
    r"(?<!L)(?<!Lesser )\bA?GPL|(?<!Lesser )General Public License", re.IGNORECASE
)


def installed(names: Iterable[str], extras: Iterable[str] = ()) -> dict[str, Distribution]:
    """Return what is installed of packages and, through all their requirements, of what they need.

    Args:
        names: Of the packages.
        extras: Names of optional groups of requirements, of these packages alone.
    """
    found: dict[str, Distribution] = {}
    waiting = [(name, frozenset(extras)) for name in names]
    seen = set()
    while waiting:
        name, wanted = waiting.pop()
        try:
            package = distribution(name)
        except PackageNotFoundError:
            # a requirement of an extra or of another platform
            continue
        found[_key(name)] = package
        for requirement in map(Requirement, package.requires or ()):
            if requirement.marker is None or any(
                requirement.marker.evaluate({"extra": extra}) for extra in {"", *wanted}
            ):
                asked = _key(requirement.name), frozenset(requirement.extras)
                if asked not in seen:
                    seen.add(asked)
                    waiting.append(asked)
    return found


def _key(name: str) -> str:
    """Return a package's name as PyPI compares them."""
    return re.sub(r"[-_.]+", "-", name).lower()


def licence(package: Distribution) -> str:
    """Return a package's licence: its expression, its classifiers or the first line of its text; empty where it states none."""
    metadata = package.metadata
    classified = [
        value.split(" :: ")[-1]
        for value in metadata.get_all("Classifier") or ()
        if value.startswith("License ::")
    ]
    stated = metadata.get("License-Expression") or ", ".join(
        value for value in classified if value != "OSI Approved"
    )
    text = (metadata.get("License") or "").strip().splitlines()
    return READ_BY_HAND.get(metadata["Name"].lower(), "") or stated or (text[0] if text else "")


def refused(text: str) -> bool:
    """Return whether a licence is one that the project must not depend on: GPL, AGPL, or none stated. A choice with another is accepted."""
    return not text or (bool(_REFUSED.search(text)) and " OR " not in text)


def main(extras: Iterable[str]) -> int:
    """Print the licences; return the exit code."""
    packages = installed([PROJECT], extras)
    rows = [
        (name, package.version, licence(package))
        for name, package in sorted(packages.items())
        if name != PROJECT
    ]
    width = max((len(name) for name, *_ in rows), default=0)
    for name, version, text in rows:
        print(
            f"{name:{width}}  {version:16}  {text or 'none stated'}{'  NOT ACCEPTED' if refused(text) else ''}"
        )
    bad = [name for name, _, text in rows if refused(text)]
    print(f"{len(rows)} packages; not accepted: {', '.join(bad) or 'none'}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
