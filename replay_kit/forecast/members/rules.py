"""Definition of members (``--members``, labels of files), and their checks: common water, duplicates, unusual speeds."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Values, one_by_one
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.grid import Ensemble, component_rms
from replay_kit.core.words.text import count_text

Kind = Literal["", "dim", "files", "suffix", "lags", "times", "models"]
#: Of these the spread of the members is not their error.
MADE: tuple[Kind, ...] = ("lags", "times", "models")

# Of a file's name, then of its folder's; the first that fits all files and tells two of them apart is taken.
_SURE = (r"(?:mem|member|ens|realization|real)[_-]?0*(\d+)(?!\d)", r"(r\d+i\d+p\d+f\d+)")
_USUAL = (*_SURE, r"number[_-]?0*(\d+)", r"^(\d{3})i?(?!\d)", r"[._-]m?(\d{2,3})\.nc\d?$")
_BACKGROUND = re.compile(r"^bg[_-]", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class MemberRule:
    """Definition of a member.

    Attributes:
        kind: Empty where undefined; ``dim``: position along a dimension; ``files``: a file, or the files of one label;
            ``suffix``: a pair of variables; ``lags``: a forecast with another reference time; ``times``: a field of another time;
            ``models``: another product.
        name: Dimension of ``dim``, regular expression of ``files``; empty for the defaults.
        days: Half width of the window of ``times`` [days].
    """

    kind: Kind
    name: str = ""
    days: float = 0.0


def parse_rule(text: str | None) -> MemberRule:
    """Return the rule of a value of ``--members``; one without a kind if it is None.

    Raises:
        ConfigError: A regular expression is invalid.
    """
    kind, _, name = (text or "").partition(":")
    if kind == "times":
        return MemberRule("times", days=float(name.removesuffix("d")))
    if kind == "files" and name:
        try:
            re.compile(name)
        except re.error as error:
            raise ConfigError(
                f"--members: '{name}' is not a regular expression: {error}"
            ) from error
    return MemberRule(kind, name)  # type: ignore[arg-type]


def label_files(paths: Sequence[Path], expression: str) -> dict[Path, str]:
    """Return the member that each file belongs to.

    Args:
        paths: Files with velocities.
        expression: Regular expression, whose first group or whole match in a path is the member; empty for the usual names, then
            one folder per member, then one file per member.

    Raises:
        ForecastError: The expression does not match a file.
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
    """Return the members by usual names such as mem001_uv.nc, r1i1p1f1 or ens01/; None unless all files have one."""
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
    """Return whether a file is a background of EnKF-C (bg_u.nc), to which anomaly members are added."""
    return bool(_BACKGROUND.match(path.name))


#: Beginning of the notes that say that something is probably wrong.
WARNING = "WARNING: "
_DUPLICATES = f"{WARNING}duplicate members"
# Faster than currents are, or slower: velocities in another unit than the file states.
_ODD_SPEEDS = (0.004, 1.5)


def common_water(
    velocity: Values, labels: tuple[str, ...], source: str
) -> tuple[Values, NDArray[np.bool_], tuple[str, ...]]:
    """Return velocities set to NaN outside the water common to all members, the common water, and notes on lost points.

    Raises:
        ForecastError: No water is left at the first level.
    """
    wet = np.ones(velocity.shape[2:], dtype=bool)
    anywhere = np.zeros(velocity.shape[2:], dtype=bool)
    counts = []
    for member in one_by_one(velocity):
        water = np.isfinite(member).all(axis=0)
        wet &= water
        anywhere |= water
        counts.append(int(water.sum()))
    missing = int(anywhere.sum()) - np.array(counts)
    worst = int(np.argmax(missing))
    if not anywhere[0].any():
        raise no_water(source)
    if not wet[0].any():
        raise ForecastError(
            f"{source}: the masks of the members leave no water at the first level; '{labels[worst]}' misses most "
            f"({int(missing[worst])} of {int(anywhere.sum())} points): leave it out"
        )
    notes: tuple[str, ...] = ()
    if missing.any():
        notes = (
            f"treated as land: {count_text(int((anywhere & ~wet).sum()), 'point')} without values in {int(np.count_nonzero(missing))} of "
            f"{len(labels)} members, most in '{labels[worst]}' ({int(missing[worst])} of {int(anywhere.sum())} points)",
        )
    for member in one_by_one(velocity) if missing.any() else ():
        member[:, ~wet] = np.nan
    return velocity, wet, notes


def no_water(source: str) -> ForecastError:
    """Return the error of a forecast without any water."""
    return ForecastError(
        f"{source}: every point of the first level is land, or the current is 0 everywhere; check the region, the time and the variables' "
        "missing values"
    )


def unusual_members(velocity: Values, labels: tuple[str, ...], source: str) -> tuple[str, ...]:
    """Return warnings of duplicate members, implausible speeds, and anomalies without a background.

    Raises:
        ForecastError: All members are identical.
    """
    speeds = member_speeds(velocity)
    notes, found, rms = [], copies(velocity, speeds), float(np.sqrt(np.mean(np.square(speeds))))
    same = [f"'{labels[k]}' and '{labels[original]}'" for k, original in found.items()]
    if len(labels) > 1 and len(found) == len(labels) - 1:
        raise ForecastError(
            f"{source}: all {len(labels)} members are identical; give members that differ"
        )
    if same:
        notes.append(f"{_DUPLICATES} are counted once: {len(same)}, such as {same[0]}; remove them")
    if rms == 0.0:
        notes.append(
            f"{WARNING}the current is 0 everywhere; choose a time after the start of the run with forecast.time, or --lead without dates"
        )
    elif not _ODD_SPEEDS[0] < rms < _ODD_SPEEDS[1]:
        notes.append(
            f"{WARNING}unusual RMS current of {rms:.3g} m/s; check the attribute units of the velocities"
        )
    if (
        len(labels) > 3
        and np.sqrt(np.nanmean(np.square(sum(one_by_one(velocity)) / len(velocity)))) < 1e-3 * rms
    ):
        notes.append(
            f"{WARNING}the members average to zero, as anomalies do; add the background (bg_*.nc) to --ensemble"
        )
    return tuple(notes)


def member_speeds(velocity: Values) -> list[float]:
    """Return the RMS velocity component of each member [m/s]."""
    return [component_rms(member[None]) for member in one_by_one(velocity)]


def copies(velocity: Values, speeds: Sequence[float]) -> dict[int, int]:
    """Return the members equal to an earlier one, each with the first such; only members of equal speed are compared."""
    found, first = dict[int, int](), dict[float, list[int]]()
    for k, speed in enumerate(speeds):
        alike = first.setdefault(speed, [])
        original = next((j for j in alike if np.array_equal(velocity[j], velocity[k], True)), None)
        if original is None:
            alike.append(k)
        else:
            found[k] = original
    return found


def without_copies(series: Sequence[Ensemble]) -> tuple[Ensemble, ...]:
    """Return a series without members that are duplicates at all times; at least two stay."""
    first, found = series[0], list[dict[int, int]]()
    for part in series:
        found.append(copies(part.velocity, member_speeds(part.velocity)))
        # those of one time alone are none
        if not found[0]:
            break
    originals = [tuple(each.get(k, k) for each in found) for k in range(first.n_members)]
    left = [k for k, each in enumerate(originals) if originals.index(each) == k]
    if len(left) < 2:
        return tuple(series)
    if len(left) == first.n_members:
        notes = tuple(note for note in first.notes if not note.startswith(_DUPLICATES))
        return (replace(first, notes=notes), *series[1:])
    return tuple(
        replace(
            part,
            velocity=part.velocity[left],
            members=tuple(part.members[k] for k in left) if part.members else (),
        )
        for part in series
    )
