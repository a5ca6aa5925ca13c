"""Checks for dead or frozen instruments and bad beams, by velocities before any rotation; and for duplicate messages.

Noise excludes zeros, equal cells or repeated pings from a working instrument. Rotation would make equal values differ.
"""

import math

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask, all_along
from replay_kit.measurements.checks.fold import (
    Context,
    Found,
    Judged,
    Memory,
    Rows,
    latest_rows,
    running_sums,
)

DEAD = "dead or stale instrument"
STUCK = "stuck cells"
BEAM = "a beam of the instrument"
DUPLICATES = "messages logged twice"
#: Cells from which the shape of a profile tells; fewer, as of a current meter or of a coarse resolution, may repeat.
LEAST_CELLS = 5
# Zeros in two cells are enough. Pings with which one is compared, those judged together, and the share and the run of bad ones from which
# the instrument is named.
_LEAST_ZEROS, _COMPARED, _WINDOW, _BAD, _RUN = 2, 16, 32, 8, 5
# What a ping is: none, sound, or bad.
_SOUND, _WORDS = 1, ("", "", "equal to an earlier ping's", "equal in all cells", "all zero")
# Pings in a row from which a cell is stuck, and from which it is named; the probability that chance makes such a run; runs below this are
# of living cells.
_STUCK_RUN, _STUCK_NAMED, _CHANCE, _LIVING = 6, 16, 1e-9, 3
# Pings after which beams and duplicates are judged; how many times as large as of the others the variance of a bad beam is, or as small;
# m/s, of a mean error velocity that neither noise nor an error of a beam's angle makes.
_LEAST, _UNLIKE, _MOST_ERROR = 30, 25.0, 0.1
_OF_BEAMS = (
    "the order or the directions of the beams, or one that is dead, blocked or disturbed",
    "its profiles are not used; exclude that beam: three are enough",
)
# Odd numbers by which the bits of a ping's values are multiplied, to tell pings apart by one number each.
_FACTORS = np.random.default_rng(0).integers(1, 2**62, 4096) | 1


def dead(memory: Memory, pings: Rows) -> tuple[Memory, list[Found], Mask]:
    """Check for pings that are zero, equal in all cells, or equal to one of the last 16; return which are, shape (n,).

    Args:
        memory: ``digest`` (17, 2), time [ns] and digest of the latest informative pings; ``kind`` (32,), their kinds.
        pings: Pings of one instrument.
    """
    raw = pings["raw"][..., :2]
    known = all_along(np.isfinite(raw))
    number, start = known.sum(axis=1), raw[np.arange(len(raw)), np.argmax(known, axis=1)]
    equal = np.asarray((all_along(raw == start[:, None]) | ~known).all(axis=1))
    zero = equal & all_along(start == 0.0) & (number >= _LEAST_ZEROS)
    told = (number >= LEAST_CELLS) | zero
    digest = latest_rows(memory, "digest", _digests(pings, pings["raw"])[told], _COMPARED + 1)
    time, velocity = np.moveaxis(digest[1:], 2, 0)
    stale = (velocity[:, :-1] == velocity[:, -1:]) & (time[:, :-1] != time[:, -1:])
    again = stale.any(axis=1)
    kind = _SOUND + np.where(zero[told], 3, np.where(equal[told], 2, again.astype(np.intp)))
    latest = latest_rows(memory, "kind", kind, _WINDOW)
    bad = latest > _SOUND

    def evidence(k: int) -> str:
        most = _WORDS[np.bincount(latest[k][bad[k]]).argmax()]
        return (
            f"the velocities of {bad[k].sum()} of the last {(latest[k] > 0).sum()} pings are {most}"
        )

    found = pings.take(told).first(
        (bad.sum(axis=1) >= _BAD) | bad[:, -_RUN:].all(axis=1),
        DEAD,
        evidence,
        "an instrument that is off or hangs, or a logger that repeats its last message",
        "those profiles are not used; check the instrument's power and its logger",
    )
    told[told] = kind > _SOUND
    return {"digest": digest[-1], "kind": latest[-1]}, found, told


def _digests(rows: Rows, values: Array) -> NDArray[np.int64]:
    """Return the time of each row, and a digest that is equal for equal values, shape (n, m, k)."""
    # cells that are missing at the end are no part of it
    bits = np.where(np.isfinite(values), values + 99.0, 0.0).view(np.int64)
    factors = np.resize(_FACTORS, math.prod(bits.shape[1:]))
    number = bits.reshape(-1, factors.size) @ factors
    return np.column_stack([rows["time"], number])


def stuck_cells(memory: Memory, pings: Rows) -> tuple[Memory, list[Found], Mask]:
    """Check for cells that repeat one value for long while others vary; return which do, shape (n, m).

    Velocities have few digits: the fraction of chance repeats in working cells determines the significant length of a run.

    Args:
        memory: ``last`` (1, m, k), previous ping; ``equal`` (16, m), repeats in the latest pings; ``counts`` (1, 2), repeats in working
            cells and their number.
        pings: Pings of one instrument, not dead, in order.
    """
    raw = pings["raw"]
    last = latest_rows(memory, "last", raw, 1)
    # an instrument may give no vertical velocity
    known, before = np.isfinite(raw), last[:-1, 0]
    some = ~all_along(~known)
    equal = all_along((raw == before) | ~(known | np.isfinite(before))) & some
    latest = latest_rows(memory, "equal", equal, _STUCK_NAMED)
    both = np.concatenate([latest[0], equal])
    row = np.arange(len(both))[:, None]
    unequal = np.maximum.accumulate(np.where(both, -1, row), axis=0)
    run = np.minimum(row - unequal, _STUCK_NAMED)[_STUCK_NAMED:]
    living = run < _LIVING
    tried = (equal & living, living & some)
    counts = running_sums(memory, "counts", np.column_stack([each.sum(axis=1) for each in tried]))
    chance = (counts[1:, :1] + 1.0) / (counts[1:, 1:] + 100.0)
    stuck = (pings["bins"] >= LEAST_CELLS)[:, None] & (run >= _STUCK_RUN)
    stuck &= run * np.log(chance) < np.log(_CHANCE)

    def evidence(k: int) -> str:
        cells = np.flatnonzero(stuck[k]) + 1
        return f"{len(cells)} of {raw.shape[1]} cells ({cells[0]} to {cells[-1]}) repeat one value, {run[k].max()} pings in a row"

    found = pings.first(
        (stuck & (run >= _STUCK_NAMED)).any(axis=1),
        STUCK,
        evidence,
        "a logger that fills cells beyond the range with their last or a fixed value",
        "those cells are not used; nothing needs to be set",
        "warning",
    )
    return {"last": last[-1], "equal": latest[-1], "counts": counts[-1:]}, found, stuck


def duplicates(memory: Memory, rows: Rows, context: Context | None = None) -> Judged:
    """Check for duplicates, pings or positions equal in time, values and log: a third of the last 30.

    Args:
        memory: ``last`` (2, 4), times [ns], digests, logs and topics of the latest rows; ``again`` (30,), whether each of the latest equals
            the previous one.
        rows: Pings of one instrument, or positions.
        context: Ignored.
    """
    place = np.column_stack([rows["longitude"], rows["latitude"]])[..., None]
    digest = _digests(rows, rows.columns.get("velocity", place))
    digest = np.column_stack([digest, rows["input"], rows["topic"]])
    last = latest_rows(memory, "last", digest, 2)
    again = all_along(last[1:, 0] == last[1:, 1])
    latest = latest_rows(memory, "again", again.astype(np.float64), _LEAST)
    number = latest.sum(axis=1)
    found = rows.first(
        3 * number >= _LEAST,
        DUPLICATES,
        lambda k: (
            f"{number[k]:.0f} of the last {_LEAST} {'messages' if rows.topic else 'positions'} equal the one before, at the same time"
        ),
        "a log with every message twice, as of two recorders that were merged",
        "each is counted once; nothing needs to be set",
        "warning",
    )
    return {"last": last[-1], "again": latest[-1]}, found


def beams(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check for a beam with other scatter than the rest, by second differences along it, or inconsistent beams.

    Args:
        memory: ``variances`` (30, k) of the beams [m^2/s^2] and ``errors`` (30,), mean error velocities [m/s], of the latest informative
            pings.
        pings: Pings of one instrument.
        context: Ignored.
    """
    texture = np.diff(pings["raw"], 2, axis=1)
    known = np.isfinite(texture)
    told = pings["along_beams"].astype(np.bool_) & (pings["bins"] >= LEAST_CELLS)
    told &= all_along(known).any(axis=1)
    pings, squares = pings.take(told), np.nanmean(texture[told] ** 2, axis=1)
    variances = latest_rows(memory, "variances", squares, _LEAST)
    usual = np.median(variances, axis=1)
    ratios = usual / np.median(usual, axis=1, keepdims=True)
    worst = np.argmax(np.abs(np.log(np.maximum(ratios, 1e-9))), axis=1)
    ratio = ratios[np.arange(len(ratios)), worst]
    found = pings.first(
        (ratio <= 1.0 / _UNLIKE) | (ratio >= _UNLIKE),
        BEAM,
        lambda k: (
            f"beam {worst[k] + 1} scatters {np.sqrt(ratio[k]):.2g} times as much as the others"
        ),
        *_OF_BEAMS,
        distrusts=True,
    )
    stated = pings.take(np.isfinite(pings["error_velocity"]))
    errors = latest_rows(memory, "errors", stated["error_velocity"], _LEAST)
    error = np.abs(np.median(errors, axis=1))
    found += stated.first(
        error >= _MOST_ERROR,
        BEAM,
        lambda k: (
            f"the beams contradict each other by {error[k]:.2f} m/s in all cells (error velocity)"
        ),
        *_OF_BEAMS,
        distrusts=True,
    )
    return {"variances": variances[-1], "errors": errors[-1]}, found
