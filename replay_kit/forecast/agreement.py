"""Members seen together: the water that all have, copies, and speeds that no current has."""

import hashlib

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, one_by_one
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import component_rms
from replay_kit.core.text import count_text

#: Beginning of the notes that say that something is probably wrong.
WARNING = "WARNING: "
# Faster than currents are, or slower: velocities in another unit than the file states.
_ODD_SPEEDS = (0.004, 1.5)


def common_water(
    velocity: Array, labels: tuple[str, ...], source: str
) -> tuple[Array, NDArray[np.bool_], tuple[str, ...]]:
    """Return velocities where all members have one, NaN being written elsewhere, where that is, and what was lost by it.

    Raises:
        ForecastError: No water is left at the first level.
    """
    wet, anywhere = (
        np.ones(velocity.shape[2:], dtype=bool),
        np.zeros(velocity.shape[2:], dtype=bool),
    )
    counts = []
    for member in one_by_one(velocity):
        own = np.isfinite(member).all(axis=0)
        wet &= own
        anywhere |= own
        counts.append(int(own.sum()))
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
            f"taken for land: {count_text(int((anywhere & ~wet).sum()), 'point')} without values in {int(np.count_nonzero(missing))} of "
            f"{len(labels)} members, most in '{labels[worst]}' ({int(missing[worst])} of {int(anywhere.sum())} points)",
        )
    for member in one_by_one(velocity) if missing.any() else ():
        member[:, ~wet] = np.nan
    return velocity, wet, notes


def no_water(source: str) -> ForecastError:
    """Return the error for a forecast without a current."""
    return ForecastError(
        f"{source}: every point of the first level is land, or the current is 0 everywhere; check the region, the time and the variables' "
        "missing values"
    )


def unusual_members(velocity: Array, labels: tuple[str, ...], source: str) -> tuple[str, ...]:
    """Return warnings of members that are the same, of speeds that no current has, and of anomalies without a state.

    Raises:
        ForecastError: All members are the same.
    """
    notes = []
    seen: dict[bytes, str] = {}
    same = []
    for label, member in zip(labels, one_by_one(velocity), strict=True):
        key = hashlib.blake2b(member.tobytes()).digest()
        if key in seen:
            same.append(f"'{label}' and '{seen[key]}'")
        seen.setdefault(key, label)
    if len(labels) > 1 and len(seen) == 1:
        raise ForecastError(
            f"{source}: all {len(labels)} members are the same; give members that differ"
        )
    if same:
        notes.append(
            f"{WARNING}members that are copies of others count twice: {len(same)}, such as {same[0]}; leave them out"
        )
    rms = component_rms(velocity)
    if rms == 0.0:
        notes.append(
            f"{WARNING}the current is 0 everywhere; choose a time after the start of the run with forecast.time"
        )
    elif not _ODD_SPEEDS[0] < rms < _ODD_SPEEDS[1]:
        notes.append(
            f"{WARNING}currents of {rms:.3g} m/s rms are no usual ones; check the attribute units of the velocities"
        )
    if (
        len(labels) > 3
        and np.sqrt(np.nanmean(np.square(sum(one_by_one(velocity)) / len(velocity)))) < 1e-3 * rms
    ):
        notes.append(
            f"{WARNING}the members cancel out in their mean, as anomalies do; give the background as bg_*.nc with --ensemble too"
        )
    return tuple(notes)
