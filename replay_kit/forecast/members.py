"""What a member is: the value of ``--members``, and the labels of files that are members."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from replay_kit.core.errors import ConfigError, ForecastError

Kind = Literal["dim", "files", "suffix", "lags", "times", "models"]
#: Of these the spread of the members is not their error.
MADE: tuple[Kind, ...] = ("lags", "times", "models")

# Of a file's name, then of its folder's; the first that fits all files and tells two of them apart is taken.
_SURE = (r"(?:mem|member|ens|realization|real)[_-]?0*(\d+)(?!\d)", r"(r\d+i\d+p\d+f\d+)")
_USUAL = (*_SURE, r"number[_-]?0*(\d+)", r"^(\d{3})i?(?!\d)", r"[._-]m?(\d{2,3})\.nc\d?$")
_BACKGROUND = re.compile(r"^bg[_-]", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class MemberRule:
    """What a member is.

    Attributes:
        kind: ``dim``: a position along a dimension; ``files``: a file, or the files of one label; ``suffix``: a pair of variables;
            ``lags``: a forecast of another reference time; ``times``: a field of another time; ``models``: another product.
        name: Dimension of ``dim``, regular expression of ``files``; empty for the usual ones.
        days: Half the width of the window of ``times`` [days].
    """

    kind: Kind
    name: str = ""
    days: float = 0.0


def parse_rule(text: str | None) -> MemberRule | None:
    """Return what ``--members`` says; None where it says nothing.

    Raises:
        ConfigError: A regular expression is none.
    """
    if text is None:
        return None
    kind, _, name = text.partition(":")
    if kind == "times":
        return MemberRule("times", days=float(name.removesuffix("d")))
    if kind == "files" and name:
        try:
            re.compile(name)
        except re.error as error:
            raise ConfigError(f"--members: '{name}' is no regular expression: {error}") from error
    return MemberRule(kind, name)  # type: ignore[arg-type]


def label_files(paths: Sequence[Path], expression: str) -> dict[Path, str]:
    """Return the member that each file belongs to.

    Args:
        paths: Files with velocities.
        expression: Regular expression whose first group, or whole match, in a file's path is the member; empty for the usual names, then
            one folder a member, then one file a member.

    Raises:
        ForecastError: The expression does not fit a file.
    """
    if expression:
        found = {path: re.search(expression, str(path)) for path in paths}
        other = next((path for path, match in found.items() if match is None), None)
        if other is not None:
            raise ForecastError(
                f"{other}: --members files:{expression} does not fit this file; leave it out, or widen the expression"
            )
        return {
            path: match[1] if match.re.groups else match[0]
            for path, match in found.items()
            if match is not None
        }
    labels = usual_labels(paths, _USUAL)
    if labels is None and len({path.parent for path in paths}) > 1:
        labels = {path: path.parent.name for path in paths}
    return labels or {path: path.name for path in paths}


def usual_labels(
    paths: Sequence[Path], expressions: Sequence[str] = _SURE
) -> dict[Path, str] | None:
    """Return the members by usual names such as mem001_uv.nc, r1i1p1f1 or ens01/; None where not all files have such a name."""
    for expression in expressions:
        for texts in ([path.name for path in paths], [path.parent.name for path in paths]):
            found = {
                path: re.search(expression, text, re.IGNORECASE)
                for path, text in zip(paths, texts, strict=True)
            }
            if all(found.values()) and len({match[1] for match in found.values() if match}) > 1:
                return {path: match[1] for path, match in found.items() if match}
    return None


def is_background(path: Path) -> bool:
    """Return whether a file is the background of EnKF-C (bg_u.nc), the state that anomaly members are about."""
    return bool(_BACKGROUND.match(path.name))
